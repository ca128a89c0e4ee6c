"""Effects between the torque that a drive is asked for and the one that its motor gives:
lag, limits, gain, sag.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from saltus.arrays import Array, Constant, Floats, namespace
from saltus.constants import PHYSICS_DT
from saltus.effects.effect import Drawable, Effect, Values, from_robot, parameter, period, setting
from saltus.effects.signals import DriveTorque
from saltus.errors import ConfigError
from saltus.robots.robot import JOINTS


@dataclass(frozen=True, kw_only=True)
class TorqueGain(Effect[DriveTorque], name="torque_gain", site="torque"):
    """A motor is stronger or weaker than its data sheet says: torque constant, gear efficiency."""

    # +-10 % is the usual range of domain randomisation
    gain: Drawable = parameter(
        unit="", null=1.0, low=0.0, high=2.0, sought=(0.3, 2.0), per_joint=True, scales="torque"
    )


@dataclass(frozen=True, kw_only=True)
class ActuatorLag(Effect[DriveTorque], name="actuator_lag", site="torque"):
    """First-order lag: torque follows its target with `time_constant`.

    Targets are held over a period; what is delivered is the mean over it, so that the impulse is
    exact.
    """

    # 2 to 8 ms on drives of this class
    time_constant: Values = parameter(
        unit="s", null=0.0, low=0.0, high=0.1, sought=(0.0, 0.05), per_joint=True
    )
    dt_s: float = period(PHYSICS_DT)
    """Period of the torque."""

    @cached_property
    def _weights(self) -> tuple[Constant, Constant]:
        """Weights of the lagged torque at the start of a period:
        in the mean over it, and in the torque at its end.
        """
        return tuple(Constant(weight) for weight in lag_weights(self.time_constant, self.dt_s))  # type: ignore[return-value]

    def first(self, signal: DriveTorque) -> Array:
        """The lagged torque at the end of the period before, shape (..., 12)."""
        return signal.torque

    def apply(self, signal: DriveTorque, time_s: Array, state: Array) -> tuple[DriveTorque, Array]:
        """Returns the mean of the lagged torque; the state is that at the end of the period."""
        before = self.first(signal) if state is None else state
        in_mean, at_end = (weight.like(signal.torque) for weight in self._weights)
        # (1 - r) x + r y, not x + r (y - x), is x to the bit where r is 0
        mean = (1.0 - in_mean) * signal.torque + in_mean * before
        return replace(signal, torque=mean), (1.0 - at_end) * signal.torque + at_end * before


def lag_weights(time_constant: Values, dt_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Weight of the lagged torque at the start of a period of `dt_s`:
    in the mean over the period, and at its end.
    """
    periods = np.asarray(time_constant, dtype=float) / dt_s
    # below a thousandth of a period the lag is none; it also keeps the division finite
    at_end = np.exp(-1.0 / np.maximum(periods, 1e-3))  # exp(-1000) is 0
    return periods * (1.0 - at_end), at_end


# Torque [Nm] and speed [rad/s] that no joint reaches, for joints without limit: infinity times a
# share of zero is not a number. float32 holds it.
UNLIMITED = 1e9


@dataclass(frozen=True, kw_only=True)
class TorqueSpeedLimit(Effect[DriveTorque], name="torque_speed_limit", site="torque"):
    """Along the motion, torque is at most the torque limit,
    less beyond `corner`, none from `no_load` on.

    Against the motion the full torque limit holds. The original's limit is the line with corner 0
    and no-load speeds 30, 30, 20 rad/s.
    """

    corner: Values = parameter(
        unit="rad/s", null=math.inf, low=0.0, high=200.0, sought=(0.0, 30.0), per_joint=True
    )
    no_load: Values = parameter(unit="rad/s", null=math.inf, low=0.3, high=200.0, per_joint=True)
    # torque up to the corner; by default the robot's torque limit
    stall: Values | None = from_robot("torque_limit", unit="Nm", high=1e5)

    def __post_init__(self) -> None:
        super().__post_init__()
        corner, no_load = np.asarray(self.corner), np.asarray(self.no_load)
        if not np.all((corner < no_load) | np.isinf(no_load)):
            raise ConfigError(
                f"{self.name}: corner = {self.corner!r} must be below no_load = {self.no_load!r} "
                "rad/s"
            )

    @cached_property
    def _bounds(self) -> tuple[Constant, Constant, Constant]:
        """Stall torque, no-load speed, and share
        of the stall torque lost per speed beyond the corner.
        """
        stall = self.of_robot("stall")
        limited = np.isfinite(self.no_load) & np.ones(len(JOINTS), dtype=bool)
        no_load = np.where(limited, self.no_load, UNLIMITED)
        span = no_load - np.where(limited, self.corner, 0.0)
        return (
            Constant(np.where(limited, stall, UNLIMITED)),
            Constant(no_load),
            Constant(1.0 / span),
        )

    def apply(self, signal: DriveTorque, time_s: Array, state: None) -> tuple[DriveTorque, None]:
        """Clips the torque."""
        torque, velocity = signal.torque, signal.velocity
        xp = namespace(torque)
        stall, no_load, slope = (constant.like(torque) for constant in self._bounds)
        along = stall * xp.clip((no_load - xp.abs(velocity)) * slope, 0.0, 1.0)
        upper = xp.where(velocity > 0, along, stall)
        lower = xp.where(velocity < 0, along, stall)
        return replace(signal, torque=xp.minimum(xp.maximum(torque, -lower), upper)), None


_CALF = 2  # in whose torque a curve is given
LOSS_AT_KNEE = 0.05
"""Definition of the knee: the command at which this share is lost."""


@dataclass(frozen=True, kw_only=True)
class TorqueSaturation(Effect[DriveTorque], name="torque_saturation", site="torque"):
    """Delivered torque as an odd, piecewise linear function of commanded torque.

    Given either as `curve`, measured at a calf and scaled to each joint by its reduction, or as
    `knee` and `plateau` at the joint: slope 1 up to a corner, then one slope. Beyond its last point
    a curve goes on with its last slope. Its rows hold a commanded torque and the one delivered, or
    the 12 delivered, one per joint, all in calf torque.
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
                f"{self.name}.curve = {self.curve!r} must be pairs, or rows of 13, that rise, from "
                "above 0"
            )
        if self.limit is None or self.reduction is None:
            return
        _, slopes = self._segments
        if not np.all((slopes >= 0.0) & (slopes <= 1.5)):
            raise ConfigError(
                f"{self.name}: knee = {self.knee!r}, plateau = {self.plateau!r} make no saturating "
                "curve"
            )

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
        # two unknowns, corner c and slope s, from c + s (knee - c) = below knee and c + s (limit -
        # c) = plateau
        slope = np.divide(
            plateau - below * knee, limit - knee, where=knee < limit, out=-np.ones_like(knee)
        )
        corner = np.where(
            exists, knee * (below - slope) / np.where(slope < 1.0, 1.0 - slope, 1.0), 0.0
        )
        slope = np.where(corner < 0.0, -1.0, slope)  # reported by the caller
        return np.stack([np.zeros_like(corner), corner]), np.stack([np.ones_like(slope), slope])

    @property
    def corners(self) -> tuple[Floats, Floats]:
        """Where the slope changes [Nm] and by how much it falls there,
        each of shape (corners, ..., 12).
        """
        starts, slopes = self._segments
        return starts, -np.diff(slopes, axis=0, prepend=1.0)

    @cached_property
    def _hinges(self) -> tuple[tuple[Constant, Constant], ...]:
        return tuple(
            (Constant(a), Constant(b)) for a, b in zip(*self.corners, strict=True) if np.any(b)
        )

    def delivered(self, torque: Floats) -> Floats:
        """Delivered torque for a commanded one, numpy or torch, shape (..., 12) [Nm]."""
        xp = namespace(torque)
        magnitude = xp.abs(torque)
        # a piecewise linear function is what comes in less a kink at every change of slope: slope 1
        # loses nothing
        lost = xp.zeros_like(torque)
        for start, fall in self._hinges:
            beyond = magnitude - start.like(torque)
            lost = lost + xp.where(beyond > 0.0, fall.like(torque) * beyond, 0.0)
        return torque - xp.sign(torque) * lost

    def apply(self, signal: DriveTorque, time_s: Array, state: None) -> tuple[DriveTorque, None]:
        """Saturates the torque."""
        return replace(signal, torque=self.delivered(signal.torque)), None


def _rises(curve: tuple[tuple[float, ...], ...]) -> bool:
    points = np.asarray(curve, dtype=float)
    is_table = points.ndim == 2 and points.shape[1] in (2, 1 + len(JOINTS))
    return is_table and bool(np.all(np.diff(points, axis=0, prepend=0.0) > 0.0))


@dataclass(frozen=True, kw_only=True)
class BatterySag(Effect[DriveTorque], name="battery_sag", site="torque"):
    """Gain that falls linearly from 1 at time 0 to 1 - `loss_at_end` at `duration_s`,
    and stays there.
    """

    # 5 to 20 % over a run
    loss_at_end: Values = parameter(
        unit="", null=0.0, low=-1.0, high=1.0, sought=(0.0, 0.7), per_joint=True
    )
    duration_s: float = setting(30.0, unit="s", low=0.1, high=1e5)
    """Length of the run; not an effect in itself, so without null value."""

    def apply(self, signal: DriveTorque, time_s: Array, state: None) -> tuple[DriveTorque, None]:
        """Scales the torque."""
        gone = namespace(time_s).clip(time_s / self.duration_s, 0.0, 1.0)
        lost = (gone if isinstance(gone, float) else gone[..., None]) * self.value(
            "loss_at_end", signal.torque
        )
        return replace(signal, torque=signal.torque * (1.0 - lost)), None


W_PER_KW = 1e3


@dataclass(frozen=True, kw_only=True)
class VoltageSag(Effect[DriveTorque], name="voltage_sag", site="torque"):
    """The battery's voltage falls with the power of all joints together,
    and with it the torque along their motion.

    Each kW that the joints then take costs the share `per_kw`. Joints that brake give nothing back.
    Where less than the share `brown_out` is left, the robot goes out: no joint gives torque again.
    """

    # resistance over the square of the voltage: 0.114 for eight cells of 12 mOhm at 29.6 V
    per_kw: float = parameter(unit="1/kW", null=0.0, low=0.0, high=2.0)
    brown_out: float = parameter(unit="", null=0.0, low=0.0, high=0.95)

    def first(self, signal: DriveTorque) -> Array:
        """1 of a robot that is on, shape (..., 1)."""
        return namespace(signal.torque).ones_like(signal.torque[..., :1])

    def apply(self, signal: DriveTorque, time_s: Array, state: Array) -> tuple[DriveTorque, Array]:
        """Scales torque along the motion; the state is 0 of a robot that has gone out,
        shape (..., 1).
        """
        on = self.first(signal) if state is None else state
        torque, xp = signal.torque, namespace(signal.torque)
        power = torque * signal.velocity
        asked_w = xp.sum(xp.where(power > 0.0, power, 0.0), axis=-1, keepdims=True)
        left = self.left(asked_w)
        on = xp.where(left < self.brown_out, 0.0 * on, on)
        return replace(signal, torque=on * xp.where(power > 0.0, left * torque, torque)), on

    def left(self, asked_w: Floats) -> Floats:
        """Share of the voltage that is left where joints are asked
        for a power along their motion [W].
        """
        return 1.0 / (1.0 + self.per_kw * asked_w / W_PER_KW)
