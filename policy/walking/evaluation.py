"""Scores of a walking policy: its ONNX file in the environment of its training, on the CPU engine.

The action is the mean one, and all draws are those of the training: bodies, pushes, noise, and the
errors of heights unless they are asked to be true.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from saltus.config import from_toml
from saltus.policy.evaluation.tracking import tracking_errors
from saltus.policy.joints.policy import JointPolicy
from saltus.policy.walking.description import POLICY_HZ
from saltus.policy.walking.settings import WalkSettings, WalkTrainSettings
from saltus.policy.walking.train import make_walk_engine
from saltus.policy.walking.walk_env import TALLY, WalkEnv
from saltus.robots.loading import load_robot

STRIDE = round(0.5 * POLICY_HZ)
"""Steps over which velocities are averaged: about a stride, within which every trunk sways."""
SETTLING = POLICY_HZ
"""Steps after a start or a new command that do not count."""


@dataclass(frozen=True, kw_only=True)
class WalkScore:
    """Falls and errors of velocity of a walking policy on one ground."""

    ground: str
    level: int
    episodes: int
    """Episodes that ended."""
    falls: int
    """Episodes that ended with a fall."""
    walked_s: float
    """Time of all robots together."""
    ahead_mps: float
    """Mean error of the velocity ahead, averaged over a stride."""
    aside_mps: float
    turn_rps: float
    way: float
    """Way along the command by the way that was commanded."""

    def line(self) -> str:
        """Line of text with the figures of a ground and level."""
        return (
            f"{self.ground}, level {self.level}: {self.falls} falls in {self.walked_s:.0f} s "
            f"({self.falls} of {self.episodes} episodes), errors {self.ahead_mps:.3f} m/s ahead, "
            f"{self.aside_mps:.3f} m/s aside, {self.turn_rps:.3f} rad/s, "
            f"way {100.0 * self.way:.0f} % of the commanded"
        )


def evaluate_walk(
    model: Path,
    ground: str,
    *,
    level: int,
    robots: int,
    seconds: float,
    seed: int,
    exact: bool = False,
) -> WalkScore:
    """Runs robots on one ground, all of one level.

    Args:
        model: The ONNX file.
        ground: A family of terrain.
        level: Of the ground.
        robots: How many run at once.
        seconds: How long.
        seed: Of all draws.
        exact: Whether heights are true.
    """
    actor = JointPolicy(model)
    trained = trained_with(actor)
    config = replace(trained, robots=robots, env=_on(trained.env, ground, exact), seed=seed)
    env = WalkEnv(make_walk_engine(load_robot(config.robot), config, "cpu"), config.env, seed=seed)
    everyone = torch.full((robots,), float(level))
    env.set_levels(everyone)
    errors, fresh, ends = [], [], np.zeros(2, dtype=np.int64)
    for _ in range(round(seconds * POLICY_HZ)):
        drawn, command = env.memory.drawn.clone(), env.memory.command.clone()
        transition = env.step(torch.as_tensor(actor(env.actor.numpy())))
        env.memory.level.copy_(everyone)
        errors.append((env.motion() - command).numpy())
        fresh.append((transition.done | (env.memory.drawn != drawn).any(-1)).numpy())
        failed = transition.done & ~transition.timed_out
        ends += [int(transition.done.sum()), int(failed.sum())]
    way = dict(zip(TALLY, env.tally[0].tolist(), strict=True))
    ahead, aside, turn = tracking_errors(
        np.array(errors), np.array(fresh), stride=STRIDE, settling=SETTLING
    )
    return WalkScore(
        ground=ground, level=level, episodes=int(ends[0]), falls=int(ends[1]),
        walked_s=robots * seconds, ahead_mps=ahead, aside_mps=aside, turn_rps=turn,
        way=way["way_m"] / max(way["asked_m"], 1e-9),
    )  # fmt: skip


def trained_with(policy: JointPolicy) -> WalkTrainSettings:
    """Configuration of the training that a policy came from; `ModelError` of somebody else's."""
    return from_toml(WalkTrainSettings, policy.file.field("config"))


def _on(config: WalkSettings, ground: str, exact: bool) -> WalkSettings:
    scan = replace(config.scan, exact=1.0 if exact else 0.0)
    only = replace(config.ground, shares={ground: 1.0})
    whole = replace(config.jump_start, share=0.0)  # no episode begins in a jump
    return replace(config, ground=only, scan=scan, jump_start=whole)
