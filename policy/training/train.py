"""Trains the motion policy, on a CPU or on GPUs, resumable at any time.

    python -m saltus.policy.training.train --out FOLDER

The folder gets `checkpoint.pt` (everything that is needed to go on), `config.toml`, `commit.txt`, `progress.csv`,
`evaluation.csv` and curves for tensorboard. With `torchrun --nproc_per_node N -m saltus.policy.training.train ...` N
GPUs learn together.
"""

import argparse
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from saltus.config import DEFAULT_ROBOT, from_toml, load
from saltus.policy.env.env import JumpEnv
from saltus.policy.env.settings import TrainConfig, for_cpu, for_gpu
from saltus.policy.training.learner import Learner, read_checkpoint
from saltus.policy.training.training_record import TrainingRecord
from saltus.provenance import commit
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot
from saltus.sim.engine import Engine
from saltus.terrain.batch import BOXES

EVALUATE_MINUTES = 3.0
"""Between evaluations with the deployed stack beside a GPU; there are none on a CPU, whose cores training needs."""


@dataclass(frozen=True, kw_only=True)
class Rank:
    """This process among those that learn together."""

    rank: int = 0
    world: int = 1
    device: str = "cpu"


def make_engine(robot: Robot, count: int, device: str, threads: int = 0) -> Engine:
    """The physics for a device: "cpu" or "cuda:N"."""
    if device == "cpu":
        from saltus.sim.batch_engine import BatchEngine

        return BatchEngine(robot, count, BOXES, threads=threads)
    from saltus.sim.warp import WarpEngine

    return WarpEngine(robot, count, BOXES, device=device)


def train(
    config: TrainConfig,
    folder: Path,
    *,
    minutes: float,
    rank: Rank,
    resume: Path | None = None,
    iterations: int | None = None,
    evaluate_minutes: float = 0.0,
    code: str | None = None,
) -> None:
    """Trains until the time is over or `iterations` are done, and saves.

    Args:
        config: The run; resuming takes networks and levels from the checkpoint and all else from here.
        folder: For the results.
        minutes: From the call of this function, with compilation.
        rank: Of this process.
        resume: Checkpoint to go on from.
        iterations: Where to stop before the time is over; counted from the very first.
        evaluate_minutes: Time between evaluations with the deployed stack, which run beside the training; 0 for none.
        code: Which code trains, where this machine cannot tell.
    """
    start = time.monotonic()
    torch.manual_seed(config.seed + 1000 * rank.rank)
    engine = make_engine(load_robot(DEFAULT_ROBOT), config.robots, rank.device)
    env = JumpEnv(engine, config.env, seed=config.seed + 1000 * rank.rank, device=rank.device)
    learner = Learner(env, config.learning, (rank.rank, rank.world))
    before_s = float(learner.load(resume)["seconds"]) if resume else 0.0
    record: TrainingRecord | None = None
    if rank.rank == 0:
        record = TrainingRecord(
            folder, config, env, learner,
            commit=code or commit(), start_s=start - before_s, evaluate_s=60.0 * evaluate_minutes, say=_say,
        )  # fmt: skip
        _say(f"ready after {time.monotonic() - start:.0f} s: {config.robots} robots on {rank.device}")
    try:
        while not _over(start, minutes, rank) and (iterations is None or learner.iteration < iterations):
            learner.collect()
            losses = learner.learn()
            if record is not None:
                record.step(losses)
        if record is not None:
            record.save()
    finally:
        if record is not None:
            record.close()


def _over(start: float, minutes: float, rank: Rank) -> bool:
    """Whether the time is over; the first process decides for all."""
    over = torch.tensor(float(time.monotonic() - start > 60.0 * minutes), device=rank.device)
    if rank.world > 1:
        torch.distributed.broadcast(over, src=0)
    return bool(over.item())


def _say(line: str) -> None:
    print(line, flush=True)  # noqa: T201


def device_of_this_process(device: str) -> Rank:
    """Where this process trains, made ready for it; `device` is "cpu", or "auto" for a GPU where there is one."""
    world = int(os.environ.get("WORLD_SIZE", "1"))
    if device == "cpu" or not torch.cuda.is_available():
        # Batches of a few hundred robots are too small to share: two threads on two busy cores wait for each other,
        # and take 11 times as long as one (docs/policy.md). The physics has threads of its own.
        torch.set_num_threads(1)
        return Rank()
    local = int(os.environ.get("LOCAL_RANK", "0"))
    torch.cuda.set_device(local)
    torch.set_float32_matmul_precision("high")
    if world > 1:
        torch.distributed.init_process_group(backend="nccl")
    return Rank(rank=int(os.environ.get("RANK", "0")), world=world, device=f"cuda:{local}")


def _config(arguments: argparse.Namespace, device: str) -> TrainConfig:
    if arguments.config:
        config = load(TrainConfig, arguments.config)
    elif arguments.resume:
        config = from_toml(TrainConfig, read_checkpoint(arguments.resume)["config"])
    else:
        config = for_cpu() if device == "cpu" else for_gpu()
    if arguments.robots is not None:
        config = replace(config, robots=arguments.robots)
    if arguments.profile:
        config = replace(config, env=replace(config.env, profile=arguments.profile))
    return config if arguments.seed is None else replace(config, seed=arguments.seed)


def main(arguments: Sequence[str] | None = None) -> None:
    """Parses the command line and trains."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder for the results")
    parser.add_argument("--minutes", type=float, default=15.0, help="time limit, with compilation")
    parser.add_argument("--iterations", type=int, help="stop at this iteration, counted from the very first")
    parser.add_argument("--resume", type=Path, help="checkpoint.pt to go on from")
    parser.add_argument("--config", type=Path, help="TOML file; default: that of the checkpoint, or the device's own")
    parser.add_argument("--robots", type=int, help="number of robots of each process")
    parser.add_argument("--seed", type=int)
    parser.add_argument("--profile", help="effects of the drives: ideal, go1, one of your own, or a TOML file")
    parser.add_argument(
        "--evaluate-minutes", type=float, help="between evaluations with the deployed stack; 0: none (default on a CPU)"
    )
    parser.add_argument("--commit", help="which code this is, where the machine has no repository")
    parser.add_argument("--device", choices=("auto", "cpu"), default="auto")
    given = parser.parse_args(arguments)
    rank = device_of_this_process(given.device)
    every = EVALUATE_MINUTES if rank.device != "cpu" else 0.0
    train(
        _config(given, rank.device),
        given.out,
        minutes=given.minutes,
        rank=rank,
        resume=given.resume,
        iterations=given.iterations,
        evaluate_minutes=every if given.evaluate_minutes is None else given.evaluate_minutes,
        code=given.commit,
    )


if __name__ == "__main__":
    main()
