"""A saturation as pairs of commanded and delivered torque,
and its way into the effect of a profile.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from saltus.arrays import Floats
from saltus.effects.motors import LOSS_AT_KNEE, TorqueSaturation
from saltus.errors import ConfigError
from saltus.real2sim.problem.log import quadruped_of
from saltus.robots.robot import JOINTS, Robot

TorqueCurve = tuple[tuple[float, float], ...]
"""Pairs of commanded and delivered torque at a joint [Nm]."""

DIGITS = 4
"""Decimal places of torques in a profile [Nm]: points that are nearer than that are one."""
BEYOND_NM = 5.0
"""From the last corner to the last point of a curve: it gives the slope with which the curve goes
on."""


def delivered_torque(curve: TorqueCurve, torque: Floats) -> Floats:
    """Delivered torque for a commanded one >= 0 [Nm].

    Beyond its last point a curve goes on with its last slope.
    """
    asked, given = np.array(((0.0, 0.0), *curve)).T
    slope = (given[-1] - given[-2]) / (asked[-1] - asked[-2])
    return np.asarray(np.interp(torque, asked, given) + slope * np.maximum(torque - asked[-1], 0.0))


def fitted_to(saturation: TorqueSaturation, model: Robot | Path) -> TorqueSaturation:
    """The saturation in the drives of a log's robot.

    Raises:
        ConfigError: it is a curve, and the log names an MJCF, which does not say to which motors it
            refers.
    """
    if saturation.curve and not isinstance(model, Robot):
        raise ConfigError(
            f"a saturation given as a curve is one of a robot with a name; the log has {model}"
        )
    return saturation.fitted(quadruped_of(model))


def corners_of(
    saturation: TorqueSaturation, model: Robot | Path, places: Sequence[Mapping[str, str]]
) -> tuple[Floats, Floats]:
    """A saturation in pieces: from which torque on each takes [Nm] and what share,
    shape (blocks, places, pieces).
    """
    starts, falls = fitted_to(saturation, model).corners
    names = [[block[place] for place in places[0] if place != "trunk"] for block in places]
    columns = np.array(
        [[JOINTS.index(name) if name in JOINTS else 0 for name in block] for block in names]
    )
    corners, slopes = (
        np.asarray(
            np.broadcast_to(each, falls.shape)[:, columns].transpose(1, 2, 0), dtype=np.float64
        )
        for each in (starts, falls)
    )
    return corners, slopes


def with_curve(
    robot: Robot, before: TorqueSaturation, joints: Sequence[int], curve: TorqueCurve
) -> TorqueSaturation:
    """A saturation with this curve at some joints,
    indices of `JOINTS`, and what it was at the others.
    """
    before = before.fitted(robot)
    scale = robot.reduction / robot.reduction[2]
    starts, falls = before.corners
    own = starts[falls != 0.0] / np.broadcast_to(scale, falls.shape)[falls != 0.0]
    asked = np.array([asked for asked, _ in curve])
    points = np.concatenate([own, *(asked / scale[j] for j in joints)])
    points = np.unique(np.round([*points, points.max() + BEYOND_NM], DIGITS))
    commanded = points[points > 0.0, None] * scale  # (n, 12)
    given = np.array(before.delivered(commanded))
    given[:, joints] = delivered_torque(curve, commanded[:, joints])
    table = np.round(np.column_stack([points[points > 0.0], given / scale]), DIGITS)
    if np.ptp(table[:, 1:], axis=1).max() == 0.0:
        table = table[:, :2]
    return TorqueSaturation(curve=tuple(tuple(row) for row in table.tolist()))


def as_knee(robot: Robot, saturation: TorqueSaturation) -> TorqueSaturation:
    """A saturation that is given as a curve,
    by the knee and plateau which that curve has at each joint; else as is.
    """
    if not saturation.curve:
        return saturation
    # (n, 12): each joint up to its limit
    grid = np.linspace(0.0, 1.0, 2001)[1:, None] * robot.torque_limit
    given = np.asarray(saturation.fitted(robot).delivered(grid))
    lost = 1.0 - given / grid >= LOSS_AT_KNEE
    knee = np.where(lost.any(axis=0), grid[lost.argmax(axis=0), np.arange(grid.shape[1])], np.inf)
    plateau = np.where(np.isfinite(knee), given[-1], np.inf)
    return TorqueSaturation(knee=tuple(knee.tolist()), plateau=tuple(plateau.tolist()))
