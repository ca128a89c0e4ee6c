"""Starts of walking episodes: standing, or in a jump, on the rear feet with the nose up.

A walking policy takes over where a jumping robot is to stop on uneven ground. Starts in a jump are
as 23 Go1 and 23 Go2 that were caught on stairs of 0.20 m: means over both, and the greater standard
deviation (docs/history.md, "Catching a robot that jumps").
"""

import math
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Array, ColumnNames, Constant, Joints, Scalars, namespace
from saltus.config import check_between
from saltus.policy.env.settings import SMALLEST
from saltus.policy.joints.walker import CAUGHT_NS
from saltus.robots.robot import Robot
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.sim.plant import CLEARANCE
from saltus.terrain.boxes import Boxes
from saltus.terrain.course_law import scale_draw

DRAWS = ColumnNames(
    jumps=(), ahead=(), up=(), pitch=(), pitch_rate=(), yaw=(), angle=(12,), rate=(12,), led=()
)
"""Uniform random numbers of a start."""
_HALF_WIDTH = math.sqrt(3.0)  # of a uniform law by its standard deviation


def _both_sides(front: tuple[float, ...], rear: tuple[float, ...]) -> Constant:
    """Values of hip, thigh and calf of the left legs as those of all joints, hips mirrored."""
    legs = [(side * leg[0], *leg[1:]) for leg in (front, rear) for side in (-1.0, 1.0)]
    return Constant(np.ravel(legs))


_ANGLE = _both_sides((0.75, 1.50, -1.68), (0.25, 1.58, -1.97))  # [rad]
_ANGLE_SPREAD = _both_sides((0.13, 0.27, 0.20), (0.06, 0.18, 0.17))
_RATE = _both_sides((8.2, -7.8, -10.1), (1.0, 6.4, 2.7))  # [rad/s]
_RATE_SPREAD = _both_sides((6.5, 5.0, 6.3), (1.0, 3.7, 3.1))


@dataclass(frozen=True, kw_only=True)
class JumpStartSettings:
    """Settings of the episodes that begin in a jump: how many do, where, and how such robots move.

    They are on the last level, whatever the robot's own: robots jump where they cannot walk.
    The ranges are two standard deviations of what was measured, to either side of its mean.
    """

    share: float = 0.0
    """Share of the episodes on the ground of `families`; 0: none begins so."""
    families: tuple[str, ...] = ("stairs",)
    lasts_s: float = 3.0
    """Length of such an episode: time to land and to come to a stand."""
    standing: float = 0.5
    """Share of them that is asked to stand, after the time of `led_time`; before it, and the others
    throughout, they are asked for the slowest walk ahead."""
    ahead_mps: tuple[float, float] = (1.1, 1.5)
    up_mps: tuple[float, float] = (0.4, 1.5)
    pitch_rad: tuple[float, float] = (-0.92, -0.61)
    """Negative: nose up."""
    pitch_rate_rps: tuple[float, float] = (-4.0, 0.2)

    def __post_init__(self) -> None:
        check_between(self, share=(0.0, 1.0), lasts_s=(SMALLEST, 20.0), standing=(0.0, 1.0))
        check_between(self, ahead_mps=(-5.0, 5.0), up_mps=(-5.0, 5.0))
        check_between(self, pitch_rad=(-1.5, 1.5), pitch_rate_rps=(-20.0, 20.0))


@dataclass(frozen=True, kw_only=True, eq=False)
class FirstMotion:
    """How robots are posed and move as an episode begins; arrays with a leading dimension of
    robots.
    """

    joints: Joints
    """Angles [rad], shape (n, 12)."""
    quaternion: Array
    """Base to world, shape (n, 4)."""
    velocity: Array
    """As `qvel` of MuJoCo: of the base, in the world, its turning in its own frame, of the joints;
    shape (n, 18)."""


def first_motion(
    jump: JumpStartSettings,
    pose: Array,
    joint_rad: float,
    yaw_rad: Scalars,
    jumps: Array,
    draws: Array,
) -> FirstMotion:
    """The motion that uniform numbers make.

    Args:
        jump: Ranges of starts in a jump.
        pose: Joints of those that stand [rad], shape (12,).
        joint_rad: Their greatest deviation from it [rad].
        yaw_rad: Greatest yaw of each robot, to either side [rad], shape (n,).
        jumps: Who begins in a jump, bool, shape (n,).
        draws: Uniform in [0, 1), shape (n, DRAWS.count).
    """
    xp, d, rows = namespace(draws), DRAWS.of(draws), jumps[:, None]

    def around(mean: Constant, spread: Constant, draw: Array) -> Joints:
        return mean.like(draw) + _HALF_WIDTH * spread.like(draw) * (2.0 * draw - 1.0)

    yaw = yaw_rad * (2.0 * d.yaw - 1.0)
    zero = xp.zeros_like(yaw)
    pitch = xp.where(jumps, scale_draw(jump.pitch_rad, d.pitch), zero)
    ahead, up = scale_draw(jump.ahead_mps, d.ahead), scale_draw(jump.up_mps, d.up)
    turning = scale_draw(jump.pitch_rate_rps, d.pitch_rate)
    base = xp.stack([ahead * xp.cos(yaw), ahead * xp.sin(yaw), up, zero, turning, zero], -1)
    velocity = xp.concat([base, around(_RATE, _RATE_SPREAD, d.rate)], axis=-1)
    standing = pose + joint_rad * (2.0 * d.angle - 1.0)
    return FirstMotion(
        joints=xp.where(rows, around(_ANGLE, _ANGLE_SPREAD, d.angle), standing),
        quaternion=quaternion_from_roll_pitch_yaw(zero, pitch, yaw),
        velocity=xp.where(rows, velocity, xp.zeros_like(velocity)),
    )


def led_time(draw: Scalars) -> Scalars:
    """Time for which robots that begin in a jump are led ahead before they stand [s], shape (n,).

    Args:
        draw: Uniform in [0, 1), shape (n,), over the times within which deployed robots are led.
    """
    return scale_draw((1e-9 * CAUGHT_NS[0], 1e-9 * CAUGHT_NS[1]), draw)


def under_trunk(robot: Robot) -> Constant:
    """Corners and middles of the trunk's lower face, base frame [m], shape (6, 3)."""
    center, half = robot.trunk_center, 0.5 * robot.trunk_size
    places = [
        (center[0] + ahead * half[0], center[1] + aside * half[1], center[2] - half[2])
        for ahead in (-1.0, 0.0, 1.0)
        for aside in (-1.0, 1.0)
    ]
    return Constant(places)


def height_above(ground: Boxes, begin: Array, places: Array, radius: float) -> Scalars:
    """Least height of bases at which all places of theirs are above the ground [m], shape (n,).

    Args:
        ground: Of each robot, arrays of shape (n, boxes, ...).
        begin: Where the bases are [m], shape (n, 2).
        places: From the base, axes of the world [m], shape (n, some, 3).
        radius: What is free below and beside each place, that of a foot [m].
    """
    xp = namespace(begin)
    x, y = begin[:, :1] + places[..., 0], begin[:, 1:] + places[..., 1]
    behind, ahead = (ground.height_at(x + side * radius, y) for side in (-1.0, 1.0))
    needed = xp.maximum(behind, ahead) - places[..., 2]
    return xp.max(needed, axis=-1) + radius + CLEARANCE
