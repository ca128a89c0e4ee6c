"""Trains the motion policy, on a CPU or on GPUs,
resumable at any time (`python -m saltus.cli.policy_train`).

The folder gets `checkpoint.pt` (everything that is needed to go on), `config.toml`, `commit.txt`,
`log.txt`, `progress.csv`, `evaluation.csv` and curves for tensorboard. With `torchrun
--nproc_per_node N -m saltus.cli.policy_train ...` N GPUs learn together.
"""

import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import torch
from tqdm import tqdm

from saltus.effects.profile import load_profile
from saltus.gpu import has_gpu
from saltus.grid import load_grid
from saltus.model_file import ModelFile
from saltus.policy.env.jump_env import JumpEnv
from saltus.policy.env.settings import JumpEnvSettings, JumpTrainSettings
from saltus.policy.training.learner import JumpLearner, Learner
from saltus.policy.training.progress import JumpTally
from saltus.policy.training.training_record import TrainingRecord
from saltus.provenance import current_commit
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot
from saltus.sim.engine import Engine


@dataclass(frozen=True, kw_only=True)
class Rank:
    """This process among those that learn together: its number, their count, and its device."""

    rank: int = 0
    world: int = 1
    device: str = "cpu"


def make_engine(
    robot: Robot, count: int, config: JumpEnvSettings, device: str, threads: int = 0
) -> Engine:
    """The physics of an environment on a device, "cpu" or "cuda:N"."""
    dimensions = config.contact_dimensions(load_profile(config.profile, robot))
    return engine_on(
        device, robot, count, config.curriculum.boxes, dimensions=dimensions, threads=threads
    )


def engine_on(
    device: str, robot: Robot, count: int, boxes: int, *, dimensions: int = 3, threads: int = 0
) -> Engine:
    """Physics of robots among boxes on a device, "cpu" (with so many threads) or "cuda:N"."""
    if device == "cpu":
        from saltus.sim.cpu_engine import CpuEngine

        return CpuEngine(robot, count, boxes, dimensions=dimensions, threads=threads)
    from saltus.sim.warp_engine import WarpEngine

    return WarpEngine(robot, count, boxes, dimensions=dimensions, device=device)


def train_policy(
    config: JumpTrainSettings,
    folder: Path,
    *,
    minutes: float,
    rank: Rank,
    resume: Path | None = None,
    start: Path | None = None,
    iterations: int | None = None,
    evaluate_minutes: float = 0.0,
    code: str | None = None,
    note: str = "",
) -> None:
    """Trains until the time is over or `iterations` are done, and saves.

    So it does where it is interrupted.

    Args:
        config: The run; resuming takes networks and levels from the checkpoint and all else from
            here.
        folder: For the results. A checkpoint that lies there is written over.
        minutes: From the call of this function, with compilation.
        rank: Of this process.
        resume: Checkpoint to go on from.
        start: ONNX file of a policy to begin with.
        iterations: Where to stop before the time is over; counted from the very first.
        evaluate_minutes: Time between evaluations with the deployed stack, which run beside the
            training; 0 for none.
        code: Which code trains, where this machine cannot tell.
        note: A line for people before it begins.

    Raises:
        KeyboardInterrupt: it was interrupted; what was learned is saved.
        SaltusError: a checkpoint cannot be read or written.
    """
    began = time.monotonic()
    torch.manual_seed(config.seed + 1000 * rank.rank)
    engine = make_engine(load_robot(config.robot), config.robots, config.env, rank.device)
    env = JumpEnv(
        engine,
        config.env,
        load_grid(config.grid),
        seed=config.seed + 1000 * rank.rank,
        device=rank.device,
    )
    learner = JumpLearner(env, config.learning, (rank.rank, rank.world))
    before_s = float(learner.load(resume)["seconds"]) if resume else 0.0
    if start:
        learner.begin_with(ModelFile(start), config.env.curriculum.levels)
    shares, record = config.env.curriculum.shares, None
    if rank.rank == 0:
        record = TrainingRecord(
            folder, config, learner, lambda: JumpTally(folder, env, learner),
            commit=code or current_commit(), start_s=began - before_s, evaluate_s=60.0 *
            evaluate_minutes, kinds=[kind for kind, share in shares.items() if share > 0.0],
            say=print_beside_bar, resumed=resume,
        )  # fmt: skip
        if note:
            record.say(note)
    ready = f"ready after {time.monotonic() - began:.0f} s: {env.count} robots on {rank.device}"
    learn_iterations(
        learner, record, paced_iterations(learner, began, minutes, iterations, rank), ready
    )


def learn_iterations(
    learner: Learner, record: TrainingRecord | None, turns: Iterator[None], ready: str
) -> None:
    """An iteration for each of `turns`; saves at the end, also where it is interrupted.

    `record` is None in processes that help the first one. `ready` is a line for people: whoever
    interrupts after it finds a checkpoint.

    Raises:
        KeyboardInterrupt: it was interrupted; what was learned is saved.
        SaltusError: the checkpoint cannot be written.
    """
    try:
        if record is not None:
            record.say(ready)
        for _ in turns:
            learner.collect()
            losses = learner.learn()
            if record is not None:
                record.step(losses)
        if record is not None:
            record.save()
    except KeyboardInterrupt:
        if record is not None:
            record.save()
            record.say(
                f"interrupted: what was learned until iteration {learner.iteration} is in "
                f"{record.checkpoint}"
            )
        raise
    finally:
        if record is not None:
            record.close()


def paced_iterations(
    learner: Learner, start: float, minutes: float, last: int | None, rank: Rank
) -> Iterator[None]:
    """One item for each iteration that there is time for,
    with a bar that shows how much of it is gone.
    """
    first = learner.iteration
    form = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}{postfix}"
    with tqdm(
        total=1.0, desc="train", bar_format=form, file=sys.stderr, disable=rank.rank > 0
    ) as bar:
        while not _over(start, minutes, rank) and (last is None or learner.iteration < last):
            yield
            share = (time.monotonic() - start) / (60.0 * minutes)
            if last is not None:
                share = max(share, (learner.iteration - first) / (last - first))
            bar.set_postfix(
                iteration=learner.iteration,
                million_steps=f"{1e-6 * learner.steps:.1f}",
                refresh=False,
            )
            bar.update(min(share, 1.0) - bar.n)


def _over(start: float, minutes: float, rank: Rank) -> bool:
    """True where the time is over; the first process decides for all."""
    over = torch.tensor(float(time.monotonic() - start > 60.0 * minutes), device=rank.device)
    if rank.world > 1:
        torch.distributed.broadcast(over, src=0)
    return bool(over.item())


def print_beside_bar(line: str) -> None:
    """Prints a line beside the bar of `paced_iterations`."""
    tqdm.write(line, file=sys.stdout)
    sys.stdout.flush()


def device_of_this_process(device: str) -> Rank:
    """Where this process trains, made ready for it; `device` is "cpu", or "auto"
    for a GPU where there is one.
    """
    world = int(os.environ.get("WORLD_SIZE", "1"))
    if device == "cpu" or not has_gpu():
        # Batches of a few hundred robots are too small to share: two threads on two busy cores wait
        # for each other, and take 11 times as long as one (docs/history.md). The physics has
        # threads of its own.
        torch.set_num_threads(1)
        return Rank()
    local = int(os.environ.get("LOCAL_RANK", "0"))
    torch.cuda.set_device(local)
    torch.set_float32_matmul_precision("high")
    if world > 1:
        torch.distributed.init_process_group(backend="nccl")
    return Rank(rank=int(os.environ.get("RANK", "0")), world=world, device=f"cuda:{local}")
