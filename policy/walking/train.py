"""Trains a walking policy, on a CPU or on a GPU, resumable at any time."""

import time
from pathlib import Path

import torch

from saltus.model_file import ModelFile
from saltus.policy.training.learner import Learner
from saltus.policy.training.train import (
    Rank,
    engine_on,
    learn_iterations,
    paced_iterations,
    print_beside_bar,
)
from saltus.policy.training.training_record import TrainingRecord
from saltus.policy.walking.export import MODEL, export_walk, make_walk_actor
from saltus.policy.walking.progress import WalkTally
from saltus.policy.walking.settings import WalkTrainSettings
from saltus.policy.walking.walk_env import WalkEnv
from saltus.provenance import current_commit
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot
from saltus.sim.engine import Engine

SAVE_S = 45.0
"""Between checkpoints: a machine may be taken away."""


def make_walk_engine(
    robot: Robot, config: WalkTrainSettings, device: str, threads: int = 0
) -> Engine:
    """The physics of an environment on a device, "cpu" or "cuda:N"."""
    return engine_on(device, robot, config.robots, config.env.ground.boxes, threads=threads)


def train_walk(
    config: WalkTrainSettings,
    folder: Path,
    *,
    minutes: float,
    rank: Rank,
    resume: Path | None = None,
    start: Path | None = None,
    iterations: int | None = None,
    code: str | None = None,
) -> None:
    """Trains until the time is over or `iterations` are done.

    Saves every 45 s, and where it is interrupted.

    Args:
        config: The run; resuming takes networks and levels from the checkpoint.
        folder: For checkpoint, model, log and table.
        minutes: From the call of this function, with compilation.
        rank: Of this process.
        resume: Checkpoint to go on from.
        start: ONNX file of a policy to begin with.
        iterations: Where to stop before the time is over; counted from the very first.
        code: Which code trains, where this machine cannot tell.

    Raises:
        KeyboardInterrupt: it was interrupted; what was learned is saved.
        SaltusError: a checkpoint cannot be read or written.
    """
    began = time.monotonic()
    torch.manual_seed(config.seed)
    engine = make_walk_engine(load_robot(config.robot), config, rank.device)
    env = WalkEnv(engine, config.env, seed=config.seed, device=rank.device)
    learner = Learner(env, config.learning, make_walk_actor(config.learning).to(rank.device))
    before_s = float(learner.load(resume)["seconds"]) if resume else 0.0
    if start:
        learner.begin_with(ModelFile(start), config.env.ground.levels)
    record = TrainingRecord(
        folder, config, learner, lambda: WalkTally(folder, env, learner), commit=code or
        current_commit(), start_s=began - before_s, say=print_beside_bar, resumed=resume,
        save_s=SAVE_S, saved=lambda checkpoint: export_walk(checkpoint, folder / MODEL),
    )  # fmt: skip
    ready = f"ready after {time.monotonic() - began:.0f} s: {env.count} robots on {rank.device}"
    learn_iterations(
        learner, record, paced_iterations(learner, began, minutes, iterations, rank), ready
    )
