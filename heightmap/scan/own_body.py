"""The robot's own body, which is not ground: points on it are taken out of the images."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Singles
from saltus.robots.leg_shapes import LegShapes
from saltus.robots.robot import Robot

MARGIN_M = 0.03
"""Beyond the shapes of the model: shells are wider than their collision shapes (a Go1's calf by
0.015 m), and depth at 0.4 m is off by a few millimetres."""


class OwnBody(Protocol):
    """Anything that says which measured points lie on the robot itself."""

    def holds(self, points: Singles, joint_position: Floats) -> NDArray[np.bool_]:
        """True for points (n, 3) of the base frame [m] that are on the robot;
        `joint_position` [rad], shape (12,).
        """
        ...


class NoBody:
    """A robot of which its cameras see nothing."""

    def holds(self, points: Singles, joint_position: Floats) -> NDArray[np.bool_]:  # noqa: ARG002
        """See `OwnBody`."""
        return np.zeros(len(points), np.bool_)


class BodyBox:
    """A box around a robot's base, in its frame: nothing in it is ground.

    `size` is its full length, width, height.
    """

    def __init__(self, size: tuple[float, float, float]) -> None:
        self._half = 0.5 * np.asarray(size, np.float32)

    def holds(self, points: Singles, joint_position: Floats) -> NDArray[np.bool_]:  # noqa: ARG002
        """See `OwnBody`."""
        return np.asarray((np.abs(points) <= self._half).all(-1))


class RobotBody:
    """Says which measured points lie on the trunk or the legs of a robot's model."""

    def __init__(self, robot: Robot) -> None:
        self._legs = LegShapes(robot)
        self._centre = robot.trunk_center.astype(np.float32)
        self._half = (0.5 * robot.trunk_size + MARGIN_M).astype(np.float32)
        self._squared = ((self._legs.radius + MARGIN_M) ** 2).astype(np.float32)

    def holds(self, points: Singles, joint_position: Floats) -> NDArray[np.bool_]:
        """See `OwnBody`."""
        on = np.asarray((np.abs(points - self._centre) <= self._half).all(-1))
        capsules = self._legs.capsules(np.asarray(joint_position, np.float64))
        start, end = (np.asarray(place, np.float32) for place in (capsules.start, capsules.end))
        low, high = np.minimum(start, end).min(0), np.maximum(start, end).max(0)
        reach = self._squared.max() ** 0.5
        near = np.flatnonzero(((points >= low - reach) & (points <= high + reach)).all(-1))
        if not len(near):
            return on
        some, along = points[near], end - start
        length = np.maximum(np.sum(along**2, -1), np.float32(1e-12))
        progress = some @ along.T - np.sum(start * along, -1)  # (near, shapes), times length
        share = (progress / length).clip(0.0, 1.0)
        from_start = np.sum(some**2, -1)[:, None] - 2.0 * (some @ start.T) + np.sum(start**2, -1)
        on[near] |= (from_start + share * (share * length - 2.0 * progress) <= self._squared).any(
            -1
        )
        return on
