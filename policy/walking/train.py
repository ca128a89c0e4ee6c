"""Trains a walking policy, on a CPU or on a GPU, resumable at any time."""

import time
from pathlib import Path

import torch

from saltus.config import to_toml
from saltus.policy.tables import append_table, carry_on
from saltus.policy.training.files import CHECKPOINT, COMMIT, PROGRESS
from saltus.policy.training.learner import Learner
from saltus.policy.training.train import Rank, paced, say
from saltus.policy.walking.env import TALLY, WalkEnv
from saltus.policy.walking.export import MODEL, export, make_actor
from saltus.policy.walking.rewards import TERMS
from saltus.policy.walking.settings import WalkTrainConfig
from saltus.provenance import commit
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot
from saltus.sim.engine import Engine

REPORT_S, SAVE_S = 10.0, 45.0


def make_engine(robot: Robot, config: WalkTrainConfig, device: str, threads: int = 0) -> Engine:
    """The physics of an environment on a device, "cpu" or "cuda:N"."""
    boxes = config.env.ground.boxes
    if device == "cpu":
        from saltus.sim.training_cpu import BatchEngine

        return BatchEngine(robot, config.robots, boxes, threads=threads)
    from saltus.sim.warp import WarpEngine

    return WarpEngine(robot, config.robots, boxes, device=device)


def train(
    config: WalkTrainConfig,
    folder: Path,
    *,
    minutes: float,
    rank: Rank,
    resume: Path | None = None,
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
        iterations: Where to stop before the time is over; counted from the very first.
        code: Which code trains, where this machine cannot tell.

    Raises:
        KeyboardInterrupt: it was interrupted; what was learned is saved.
        SaltusError: a checkpoint cannot be read or written.
    """
    start = time.monotonic()
    torch.manual_seed(config.seed)
    engine = make_engine(load_robot(config.robot), config, rank.device)
    env = WalkEnv(engine, config.env, seed=config.seed, device=rank.device)
    learner = Learner(env, config.learning, make_actor(config.learning).to(rank.device))
    before_s = float(learner.load(resume)["seconds"]) if resume else 0.0
    record = Record(folder, config, env, learner, start - before_s, code or commit(), resume)
    record.say(f"ready after {time.monotonic() - start:.0f} s: {env.count} robots, {rank.device}")
    try:
        for _ in paced(learner, start, minutes, iterations, rank):
            learner.collect()
            record.step(learner.learn())
    finally:
        record.save()


class Record:
    """Files in a training's folder: checkpoint, model, configuration, log and table."""

    def __init__(
        self,
        folder: Path,
        config: WalkTrainConfig,
        env: WalkEnv,
        learner: Learner,
        start_s: float,
        code: str,
        resumed: Path | None,
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        if resumed is not None:
            carry_on(resumed.parent / PROGRESS, folder / PROGRESS, learner.iteration)
        self._folder, self._env, self._learner, self._start_s = folder, env, learner, start_s
        self._extra = {"config": to_toml(config), "commit": code}
        (folder / "config.toml").write_text(self._extra["config"], encoding="utf-8")
        (folder / COMMIT).write_text(code + "\n", encoding="utf-8")
        self._reported = self._saved = time.monotonic()
        self._steps = learner.steps

    def say(self, line: str) -> None:
        """Tells people, and the log."""
        say(line)
        with (self._folder / "log.txt").open("a", encoding="utf-8") as log:
            log.write(line + "\n")

    def step(self, losses: dict[str, float]) -> None:
        """After an iteration: reports and saves what is due."""
        now = time.monotonic()
        if now - self._reported > REPORT_S:
            self._report(losses, now)
        if now - self._saved > SAVE_S:
            self.save()

    def save(self) -> None:
        """Writes the checkpoint and its model."""
        now = time.monotonic()
        path = self._folder / CHECKPOINT
        self._learner.save(path, {**self._extra, "seconds": now - self._start_s})
        export(path, self._folder / MODEL)
        self._saved = time.monotonic()

    def _report(self, losses: dict[str, float], now: float) -> None:
        learner, env = self._learner, self._env
        fresh = learner.steps - self._steps
        steps = max(fresh / env.count, 1.0)
        terms = (env.term_sums / steps).tolist()
        row = {
            "iteration": float(learner.iteration),
            "steps": float(learner.steps),
            "seconds": now - self._start_s,
            "steps_per_s": fresh / (now - self._reported),
            "learning_rate": learner.ppo.learning_rate,
            "std": learner.std,
            "crowded": env.crowded_share(),
            "reward": 50.0 * sum(terms),
            **losses,
            **{f"reward/{name}": 50.0 * value for name, value in zip(TERMS, terms, strict=True)},
            **self._grounds(),
        }
        env.term_sums.zero_()
        append_table(
            self._folder / PROGRESS, [{name: f"{value:.5g}" for name, value in row.items()}]
        )
        self.say(_line(row, list(env.config.ground.shares)))
        self._reported, self._steps = now, learner.steps

    def _grounds(self) -> dict[str, float]:
        env, values = self._env, {}
        for k, kind in enumerate(env.config.ground.shares):
            counts = dict(zip(TALLY, env.tally[k].tolist(), strict=True))
            steps, episodes = max(counts["steps"], 1.0), max(counts["episodes"], 1.0)
            level = env.memory.level[env.memory.kind == k]
            values[f"{kind}/level"] = float(level.mean()) if len(level) else 0.0
            values[f"{kind}/failed"] = counts["failed"] / episodes
            values[f"{kind}/speed_error"] = counts["speed_error"] / steps
            values[f"{kind}/turn_error"] = counts["turn_error"] / steps
            values[f"{kind}/way"] = counts["way_m"] / max(counts["asked_m"], 1e-9)
        env.tally.zero_()
        return values


def _line(row: dict[str, float], kinds: list[str]) -> str:
    grounds = [
        f"{kind} L{row[f'{kind}/level']:.1f} fell{100 * row[f'{kind}/failed']:.0f}% "
        f"v{row[f'{kind}/speed_error']:.2f} w{row[f'{kind}/turn_error']:.2f} "
        f"way{100 * row[f'{kind}/way']:.0f}%"
        for kind in kinds
    ]
    return (
        f"it {row['iteration']:.0f} {row['steps'] / 1e6:.1f}M {row['seconds']:.0f}s "
        f"{row['steps_per_s'] / 1e3:.1f}k/s rew {row['reward']:.2f} std {row['std']:.2f} "
        f"lr {row['learning_rate']:.0e} crowded {row['crowded']:.4f} | " + " | ".join(grounds)
    )
