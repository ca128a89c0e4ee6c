"""Trains the motion policy: `python -m policy.train --out FOLDER`, on a CPU or on GPUs, resumable at any time.

The folder gets `checkpoint.pt` (everything that is needed to go on), `config.toml`, `commit.txt`, `progress.csv` and
curves for tensorboard. With `torchrun --nproc_per_node N -m policy.train ...` N GPUs learn together.
"""

import argparse
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from policy.env import JumpEnv
from policy.learner import Learner, read_checkpoint
from policy.progress import Progress
from policy.settings import TrainConfig, for_cpu, for_gpu
from saltus.config import from_toml, load, to_toml
from saltus.provenance import commit
from saltus.sim.engine import Engine
from saltus.terrain.batch import BOXES

_REPORT_S = 10.0
_SAVE_S = 120.0


@dataclass(frozen=True, kw_only=True)
class Rank:
    """This process among those that learn together."""

    rank: int = 0
    world: int = 1
    device: str = "cpu"


def make_engine(count: int, device: str, threads: int = 0) -> Engine:
    """The physics for a device: "cpu" or "cuda:N"."""
    if device == "cpu":
        from saltus.sim.batch_engine import BatchEngine

        return BatchEngine(count, BOXES, threads=threads)
    from saltus.sim.warp import WarpEngine

    return WarpEngine(count, BOXES, device=device)


def train(
    config: TrainConfig,
    folder: Path,
    *,
    minutes: float,
    rank: Rank,
    resume: Path | None = None,
    iterations: int | None = None,
) -> None:
    """Trains until the time is over or `iterations` are done, and saves.

    Args:
        config: The run; resuming takes networks and levels from the checkpoint and all else from here.
        folder: For the results.
        minutes: From the call of this function, with compilation.
        rank: Of this process.
        resume: Checkpoint to go on from.
        iterations: Where to stop before the time is over; counted from the very first.
    """
    start = time.monotonic()
    torch.manual_seed(config.seed + 1000 * rank.rank)
    env = JumpEnv(
        make_engine(config.robots, rank.device), config.env, seed=config.seed + 1000 * rank.rank, device=rank.device
    )
    learner = Learner(env, config.learning, (rank.rank, rank.world))
    before_s = float(learner.load(resume)["seconds"]) if resume else 0.0
    writes = rank.rank == 0
    if writes:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "config.toml").write_text(to_toml(config))
        (folder / "commit.txt").write_text(commit() + "\n")
        progress = Progress(folder, env, learner)
        _say(f"ready after {time.monotonic() - start:.0f} s: {config.robots} robots on {rank.device}")

    def save() -> None:
        seconds = before_s + time.monotonic() - start
        learner.save(folder / "checkpoint.pt", {"seconds": seconds, "config": to_toml(config), "commit": commit()})

    reported = saved = time.monotonic()
    while not _over(start, minutes, rank) and (iterations is None or learner.iteration < iterations):
        learner.collect()
        losses = learner.learn()
        now = time.monotonic()
        if writes and now - reported > _REPORT_S:
            _say(progress.report(losses, now - reported, before_s + now - start))
            reported = now
        if writes and now - saved > _SAVE_S:
            save()
            saved = now
    if writes:
        save()
        progress.close()


def _over(start: float, minutes: float, rank: Rank) -> bool:
    """Whether the time is over; the first process decides for all."""
    over = torch.tensor(float(time.monotonic() - start > 60.0 * minutes), device=rank.device)
    if rank.world > 1:
        torch.distributed.broadcast(over, src=0)
    return bool(over.item())


def _say(line: str) -> None:
    print(line, flush=True)  # noqa: T201


def _rank(device: str) -> Rank:
    world = int(os.environ.get("WORLD_SIZE", "1"))
    if device == "cpu" or not torch.cuda.is_available():
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
    parser.add_argument("--device", choices=("auto", "cpu"), default="auto")
    given = parser.parse_args(arguments)
    rank = _rank(given.device)
    train(
        _config(given, rank.device),
        given.out,
        minutes=given.minutes,
        rank=rank,
        resume=given.resume,
        iterations=given.iterations,
    )


if __name__ == "__main__":
    main()
