"""Somebody's odometry: what a robot believes of its motion, with the errors that odometry has."""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from saltus.heightmap.scan.training.flight_motion import FlightMotion
from saltus.heightmap.scan.training.pose_tables import STEP_S, turn_by_yaw
from saltus.heightmap.scan.training.seeded_random import SeededRandom
from saltus.heightmap.scan.training.settings import FlightSettings

SPEED_SHARE = 0.03
"""By how much speed is off, usually."""
SPEED_MPS = 0.015
"""Error of the speed beside that, however fast the robot is [m/s]."""
HEIGHT_MPS = 0.02
"""Drift of the height [m/s]; a Go1's that climbs drifts by 0.05 (recorded runs of the project)."""
YAW_RADPS = math.radians(0.5)
"""Drift of the yaw [rad/s]."""
LEVEL_RAD = math.radians(0.4)
"""Constant error of roll and pitch [rad]; as much again swings within seconds."""
WALK_M = 0.004
"""Random walk of the position in a second [m]."""


class FlightOdometry(NamedTuple):
    """Motion of the robots of a flight as their odometry tells it: tables as those of
    `FlightMotion`.
    """

    position: Tensor
    angles: Tensor
    scale: Tensor
    """1 for usual errors, 2 for bad ones, shape (robots,)."""


def draw_odometry(
    motion: FlightMotion, settings: FlightSettings, draws: SeededRandom
) -> FlightOdometry:
    """Odometry of a motion; it begins at the true place and yaw."""
    n, steps, _ = motion.position.shape
    scale = draws.uniform(*settings.odometry, n)
    time = torch.arange(steps, device=draws.device) * STEP_S

    def swing(size: float) -> Tensor:
        cycle = (
            2.0 * math.pi * draws.log_uniform(0.3, 3.0, n)[:, None] * time
            + draws.uniform(0.0, 6.3, n)[:, None]
        )
        return draws.normal(size, n)[:, None] * cycle.sin()

    level = [draws.normal(LEVEL_RAD, n)[:, None] + swing(LEVEL_RAD) for _ in range(2)]
    drift = draws.normal(YAW_RADPS, n)[:, None] * time
    off = torch.stack((*level, drift), -1) * scale[:, None, None]
    step = motion.position.diff(dim=1)
    yaw = motion.angles[:, :-1, 2]
    own = _turned(step[..., :2], -yaw)
    factor = 1.0 + scale[:, None, None] * draws.normal(SPEED_SHARE, n, 1, 2)
    extra = draws.normal(SPEED_MPS, n, 1, 2) * STEP_S + draws.normal(
        WALK_M * math.sqrt(STEP_S), n, steps - 1, 2
    )
    level_step = _turned(own * factor + scale[:, None, None] * extra, yaw + off[:, :-1, 2])
    height = draws.normal(HEIGHT_MPS, n, 1) * STEP_S + draws.normal(
        WALK_M * math.sqrt(STEP_S), n, steps - 1
    )
    climb = step[..., 2] + scale[:, None] * height
    moves = torch.cat((level_step, climb[..., None]), -1).cumsum(1)
    if settings.velocity < 1.0:  # with no draw otherwise: flights of before stay what they were
        moves = torch.where(draws.chance(settings.velocity, n, 1, 1), moves, 0.0)
    first = motion.position[:, :1]
    return FlightOdometry(torch.cat((first, first + moves), 1), motion.angles + off, scale)


def _turned(xy: Tensor, yaw: Tensor) -> Tensor:
    n, steps, _ = xy.shape
    return turn_by_yaw(xy.reshape(n * steps, 1, 2), yaw.reshape(-1)).view(n, steps, 2)
