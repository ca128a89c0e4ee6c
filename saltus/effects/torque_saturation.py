"""Iron saturates: at high current a motor delivers less torque than is commanded."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from saltus.arrays import Array, Constant, Floats, namespace
from saltus.effects.effect import Effect, Values, from_robot, parameter
from saltus.effects.signals import Drive
from saltus.errors import ConfigError
from saltus.robots.robot import JOINTS

_CALF = 2  # in whose torque a curve is given
LOSS_AT_KNEE = 0.05
"""Definition of the knee: the command at which this share is lost."""


@dataclass(frozen=True, kw_only=True)
class TorqueSaturation(Effect[Drive], name="torque_saturation", site="torque"):
    """Delivered torque as an odd, piecewise linear function of commanded torque.

    Given either as `curve`, measured at a calf and scaled to each joint by its reduction, or as `knee` and `plateau`
    at the joint: slope 1 up to a corner, then one slope. Beyond its last point a curve goes on with its last slope. Its
    rows hold a commanded torque and the one delivered, or the 12 delivered, one per joint, all in calf torque.
    """

    # rows that rise, in calf torque; () is no loss
    curve: tuple[tuple[float, ...], ...] = parameter(unit="Nm", null=(), low=0.0, high=200.0)
    knee: Values = parameter(unit="Nm", null=math.inf, low=0.1, high=200.0, per_joint=True)
    # delivered where `limit` is commanded
    plateau: Values = parameter(unit="Nm", null=math.inf, low=0.1, high=200.0, per_joint=True)
    # by default the robot's torque limit
    limit: Values | None = from_robot("torque_limit", unit="Nm", high=1e5)
    # from motor to joint; by default the robot's
    reduction: Values | None = from_robot("reduction", unit="", high=1e3)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.curve and not (np.all(np.isinf(self.knee)) and np.all(np.isinf(self.plateau))):
            raise ConfigError(f"{self.name}: give curve, or knee and plateau, not both")
        if np.any(np.isinf(self.knee) != np.isinf(self.plateau)):
            raise ConfigError(f"{self.name}: knee and plateau come together")
        if self.curve and not _rises(self.curve):
            raise ConfigError(
                f"{self.name}.curve = {self.curve!r} must be pairs, or rows of 13, that rise, from above 0"
            )
        if self.limit is None or self.reduction is None:
            return
        _, slopes = self._segments
        if not np.all((slopes >= 0.0) & (slopes <= 1.5)):
            raise ConfigError(f"{self.name}: knee = {self.knee!r}, plateau = {self.plateau!r} make no saturating curve")

    @cached_property
    def _segments(self) -> tuple[Floats, Floats]:
        """Where segments begin [Nm] and their slopes, each of shape (segments, ..., 12)."""
        if self.curve:
            points = np.array([(0.0,) * len(self.curve[0]), *self.curve])
            reduction = self.of_robot("reduction")
            scale = reduction / reduction[_CALF]
            slopes = np.diff(points[:, 1:], axis=0) / np.diff(points[:, :1], axis=0)
            return points[:-1, :1] * scale, np.broadcast_to(slopes, (len(slopes), len(JOINTS)))
        limit = self.of_robot("limit")
        exists = np.isfinite(self.knee) & np.ones(len(JOINTS), dtype=bool)
        knee = np.where(exists, self.knee, 0.5 * limit)
        plateau = np.where(exists, self.plateau, limit)
        below = np.where(exists, 1.0 - LOSS_AT_KNEE, 1.0)
        # two unknowns, corner c and slope s, from c + s (knee - c) = below knee and c + s (limit - c) = plateau
        slope = np.divide(plateau - below * knee, limit - knee, where=knee < limit, out=-np.ones_like(knee))
        corner = np.where(exists, knee * (below - slope) / np.where(slope < 1.0, 1.0 - slope, 1.0), 0.0)
        slope = np.where(corner < 0.0, -1.0, slope)  # reported by the caller
        return np.stack([np.zeros_like(corner), corner]), np.stack([np.ones_like(slope), slope])

    @property
    def corners(self) -> tuple[Floats, Floats]:
        """Where the slope changes [Nm] and by how much it falls there, each of shape (corners, ..., 12)."""
        starts, slopes = self._segments
        return starts, -np.diff(slopes, axis=0, prepend=1.0)

    @cached_property
    def _hinges(self) -> tuple[tuple[Constant, Constant], ...]:
        return tuple((Constant(a), Constant(b)) for a, b in zip(*self.corners, strict=True) if np.any(b))

    def delivered(self, torque: Floats) -> Floats:
        """Delivered torque for a commanded one, numpy or torch, shape (..., 12) [Nm]."""
        xp = namespace(torque)
        magnitude = xp.abs(torque)
        # a piecewise linear function is what comes in less a hinge at every change of slope: slope 1 loses nothing
        lost = xp.zeros_like(torque)
        for start, fall in self._hinges:
            beyond = magnitude - start.like(torque)
            lost = lost + xp.where(beyond > 0.0, fall.like(torque) * beyond, 0.0)
        return torque - xp.sign(torque) * lost

    def apply(self, signal: Drive, time_s: Array, state: None) -> tuple[Drive, None]:
        """Saturates the torque."""
        del time_s, state
        return replace(signal, torque=self.delivered(signal.torque)), None


def _rises(curve: tuple[tuple[float, ...], ...]) -> bool:
    points = np.asarray(curve, dtype=float)
    is_table = points.ndim == 2 and points.shape[1] in (2, 1 + len(JOINTS))
    return is_table and bool(np.all(np.diff(points, axis=0, prepend=0.0) > 0.0))
