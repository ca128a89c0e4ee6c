"""The effects of many sets of unknowns, as arrays that act on all simulations of a replay at once.

The physics is that of `saltus.effects`; a test holds the two together. Here a delay knows the whole
log in advance, effects that no set has cost nothing, and four effects have a weight, 0 absent and 1
present, so that they come in smoothly.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.effects.delay_line import held_late
from saltus.effects.encoders import low_pass_weights
from saltus.effects.motors import lag_weights

LEAST_LEVEL = 1e-6  # Nm of dry friction: none at all
Kinks = tuple[tuple[Floats, Floats], ...]


class DriveState:
    """Memory of the encoders and drives of a replay from the last instant; None where nothing has
    been yet.
    """

    def __init__(self) -> None:
        self.velocity: Floats | None = None
        self.filtered: Floats | None = None
        self.lagged: Floats | None = None
        self.steepness: Floats | None = None
        """By how much the torque of the last call falls with velocity [Nm s/rad], where a speed
        limit holds it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointDrives:
    """Effects in drives and encoders with which joints are replayed; arrays of shape (branches,
    joints, sets); None is an effect that no set has.
    """

    count: int
    """Number of sets."""
    dt_s: float
    limit: Floats
    """Torque limits of the joints [Nm], shape (branches, joints, 1)."""
    kinks: Kinks = ()
    """A saturation in pieces: slopes that are lost, and the torque [Nm] from which on, shape
    (joints, 1)."""
    command_delay: Floats | None = None
    feedforward_delay: Floats | None = None
    actuator_lag: Floats | None = None
    torque_speed_limit: tuple[Floats, Floats, Floats] | None = None
    """Weight, corner, and from there to the no-load speed [rad/s]."""
    torque_saturation: tuple[Floats, Floats, Floats] | None = None
    """Slope that is lost, the torque from which on, and how rounded that corner is [Nm]; see
    `lost_to_saturation`."""
    torque_gain: Floats | None = None
    """Less 1."""
    battery_sag: Floats | None = None
    viscous_friction: Floats | None = None
    coulomb_friction: tuple[Floats, Floats] | None = None
    """Torque [Nm], and how far its bristles bend before they give way [rad]."""
    stiction: tuple[Floats, Floats, Floats] | None = None
    """Breakaway [Nm], Stribeck velocity [rad/s], and how far its bristles bend [rad]."""
    backlash: tuple[Floats, Floats] | None = None
    """Width [rad] and where the logged encoder sits: 0 at the joint, 1 at the motor."""
    joint_spring: tuple[Floats, Floats] | None = None
    """Pull at the zero angle [Nm] and stiffness [Nm/rad]."""
    end_stop: tuple[Floats, Floats, Floats] | None = None
    """Side, +1 at large angles and -1 at small ones, where it begins [rad], and stiffness
    [Nm/rad]."""
    base_roll: tuple[Floats, Floats, Floats] | None = None
    """Weight, give [rad/Nm] and damping [Nm s/rad] of what holds the base, shape (branches,
    sets)."""
    armature: Floats | None = None
    encoder_bias: Floats | None = None
    encoder_quantisation: tuple[Floats, Floats] | None = None
    """Weight and step [rad]."""
    velocity_filter: Floats | None = None
    velocity_scale: Floats | None = None
    """Ratio of measured to true velocity, less 1."""
    drive_rate: Floats | None = None
    """Rate of the drive's loop, as 1 - 1/n where it evaluates its law n times in a step of the
    replay: 0 at the replay's own rate, 1 without end."""
    between: Floats | float | None = None
    """In a replay twice as fine as the slowest loop: how much of a drive computes its torque at
    every second instant, too; None in others."""
    holds_limit: bool = False
    """True where a speed limit sees the velocity once an instant, as in the plant; False where it
    also sees how the velocity changes meanwhile."""

    @property
    def is_dry(self) -> bool:
        """True where any set has dry friction."""
        return self.coulomb_friction is not None or self.stiction is not None

    @cached_property
    def bristles(self) -> Floats | None:
        """How far those of all dry friction bend together before they give way [rad];
        None where they are rigid.
        """
        both = [dry for dry in (self.coulomb_friction, self.stiction) if dry is not None]
        bent = [level * bend for level, *_, bend in both]
        if not any(np.any(each) for each in bent):
            return None
        return np.asarray(sum(bent) / np.maximum(sum(level for level, *_ in both), LEAST_LEVEL))

    def twice_as_fine(self) -> "JointDrives":
        """A copy of the drives for instants that are twice as close.

        A loop at the coarser rate skips every second one.
        """
        if self.drive_rate is None:
            return replace(self, dt_s=0.5 * self.dt_s, between=0.0)
        rate = np.maximum(2.0 * self.drive_rate - 1.0, 0.0)
        between = np.minimum(2.0 * self.drive_rate, 1.0)
        return replace(
            self, dt_s=0.5 * self.dt_s, drive_rate=rate if rate.any() else None, between=between
        )

    def sent(
        self,
        law: Floats,
        feedforward: Floats | None,
        instants: Indices,
        first: Indices,
        last: Indices,
    ) -> Floats:
        """Law and feed-forward [Nm] that the drives use at the instants,
        shape (windows, branches, joints, sets).

        Args:
            law: kp q_des + kd dq_des [Nm], shape (instants, branches, joints).
            feedforward: Added to the law, later than it by a delay of its own if the drives have
                one [Nm], the same shape; None where `law` holds it already.
            instants: Now, shape (windows,).
            first: Of the stretch of the log: nothing older is used. Shape (windows,).
            last: Of the stretch: nothing newer is used.
        """
        if feedforward is not None and self.feedforward_delay is None:
            law, feedforward = law + feedforward, None
        if self.command_delay is None and feedforward is None:
            return law[np.minimum(instants, last)][..., None]
        delay = np.zeros((*law.shape[1:], 1)) if self.command_delay is None else self.command_delay
        late = _late(law, instants, delay / self.dt_s, first, last)
        if feedforward is None or self.feedforward_delay is None:
            return late
        own = (delay + self.feedforward_delay) / self.dt_s
        return late + _late(feedforward, instants, own, first, last)

    def sensed(
        self, position: Floats, velocity: Floats, state: DriveState
    ) -> tuple[Floats, Floats]:
        """Angles [rad] and velocities [rad/s] that the encoders read, for the true ones.

        Shapes are (windows, branches, joints, sets).
        """
        if self.encoder_bias is not None:
            position = position + self.encoder_bias
        if self.encoder_quantisation is not None:
            weight, step = self.encoder_quantisation
            position = position + weight * (np.round(position / step) * step - position)
        if self.velocity_filter is not None:
            if state.velocity is None or state.filtered is None:
                filtered = velocity.copy()
            else:
                new, old, kept = self._filter_weights
                filtered = new * velocity + old * state.velocity + kept * state.filtered
            state.velocity, state.filtered = velocity.copy(), filtered
            velocity = filtered
        return position, velocity if self.velocity_scale is None else velocity * (
            1.0 + self.velocity_scale
        )

    def delivered(
        self, torque: Floats, velocity: Floats, elapsed: Floats, state: DriveState
    ) -> Floats:
        """Torque on the motor's side of the play."""
        if self.actuator_lag is not None:
            start = torque if state.lagged is None else state.lagged
            in_mean, at_end = self._lag_weights
            state.lagged = torque + at_end * (start - torque)
            torque = torque + in_mean * (start - torque)
        if self.torque_speed_limit is not None:
            torque, state.steepness = self._limited(torque, velocity, self.torque_speed_limit[0])
        if self.torque_saturation is not None or self.kinks:
            torque = torque - np.sign(torque) * self._saturated(np.abs(torque))
        if self.torque_gain is not None:
            torque = torque * (1.0 + self.torque_gain)
        if self.battery_sag is not None:
            torque = torque * (1.0 - elapsed * self.battery_sag)
        return torque

    def held_back(self, position: Floats) -> Floats | float:
        """Torque against positive motion of springs and stops [Nm]."""
        torque: Floats | float = 0.0
        if self.joint_spring is not None:
            pull, stiffness = self.joint_spring
            torque = stiffness * position - pull
        if self.end_stop is not None:
            side, begin, stiffness = self.end_stop
            torque = torque + side * stiffness * np.maximum(side * (position - begin), 0.0)
        return torque

    def friction(self, velocity: Floats) -> Floats:
        """Level of dry friction [Nm]."""
        level = np.zeros(()) if self.coulomb_friction is None else self.coulomb_friction[0]
        if self.stiction is not None:
            breakaway, width, _ = self.stiction
            level = level + breakaway * np.exp(-((velocity / width) ** 2))
        return level

    def _saturated(self, magnitude: Floats) -> Floats:
        """Torque [Nm] that saturation takes from a commanded one >= 0; a law and pieces add up."""
        missing = (
            np.zeros(())
            if self.torque_saturation is None
            else lost_to_saturation(magnitude, *self.torque_saturation)
        )
        for slope, corner in self.kinks:
            missing = missing + slope * np.maximum(magnitude - corner, 0.0)
        return missing

    # What stays the same over a replay, of which each step takes its turn

    @cached_property
    def _filter_weights(self) -> tuple[Floats, Floats, Floats]:
        assert self.velocity_filter is not None  # noqa: S101 - who has none does not ask
        return low_pass_weights(self.velocity_filter, self.dt_s)

    @cached_property
    def _lag_weights(self) -> tuple[Floats, Floats]:
        assert self.actuator_lag is not None  # noqa: S101 - who has none does not ask
        return lag_weights(self.actuator_lag, self.dt_s)

    @cached_property
    def _speed_line(self) -> tuple[Floats, Floats, Floats]:
        """No-load speed, its distance from the corner [rad/s],
        and by how much torque falls in between [Nm s/rad].
        """
        assert self.torque_speed_limit is not None  # noqa: S101 - who has none does not ask
        weight, corner, span = self.torque_speed_limit
        no_load = corner + span
        return no_load, no_load - corner, weight * self.limit / (no_load - corner)

    def _limited(
        self, torque: Floats, velocity: Floats, weight: Floats
    ) -> tuple[Floats, Floats | None]:
        """Torque within the limit of speed,
        and how it falls with velocity; None where it nowhere does.
        """
        no_load, span, slope = self._speed_line
        direction = np.sign(velocity)
        along = torque * direction
        share = np.minimum(np.maximum((no_load - np.abs(velocity)) / span, 0.0), 1.0)
        bound = self.limit * share
        allowed = np.maximum(np.minimum(along, bound), -self.limit)
        held = torque + weight * (allowed - along) * direction
        if self.holds_limit:
            return held, None
        falls = (along > bound) & (share > 0.0) & (share < 1.0)
        return held, np.where(falls, slope, 0.0) if falls.any() else None


def lost_to_saturation(torque: Floats, slope: Floats, corner: Floats, rounding: Floats) -> Floats:
    """Torque [Nm] that saturation takes from a torque >= 0:
    none at 0, in the end `slope` times what is above `corner`.

    The corner is rounded over a few times `rounding`: iron saturates little by little. Of more
    torque the share `slope` (cosh(torque / rounding) - 1) / (cosh(torque / rounding) +
    cosh(corner / rounding)) is lost, which is that of a tanh of scale 2 `rounding` where `corner`
    is small beside it, and that of a sharp corner where `rounding` is.
    """
    above, bend = torque / rounding, corner / rounding
    # log(cosh((above + bend) / 2) / cosh((above - bend) / 2)), without overflow
    near, far = np.exp(-np.abs(above - bend)), np.exp(-above - bend)
    rise = np.minimum(above, bend) + np.log1p((far - near) / (1.0 + near))
    return np.asarray(slope * (torque - rounding / np.tanh(0.5 * bend) * rise))


def saturation_loss(
    kinks: Kinks, joint_of_leg: int, torque: Floats, legs: slice = slice(None)
) -> Floats:
    """Torque [Nm] that a saturation in pieces takes of one >= 0, mean of those legs that have it.

    `joint_of_leg` counts the joints of a leg from 0.
    """
    loss = np.zeros(())
    for slopes, corners in kinks:
        slope, corner = slopes[legs, joint_of_leg, 0], corners[legs, joint_of_leg, 0]
        own = slope != 0.0
        if own.any():
            loss = loss + slope[own].mean() * np.maximum(torque - corner[own].mean(), 0.0)
    return loss


def _late(
    stream: Floats, instants: Indices, steps: Floats, first: Indices, last: Indices
) -> Floats:
    """A held stream that is `steps` instants late,
    shape (branches, joints, sets), averaged over the coming one.
    """
    branches, joints = stream.shape[1:]
    place = np.arange(branches * joints).reshape(branches, joints, 1)
    now, first, last = (each[:, None, None, None] for each in (instants, first, last))
    flat = stream.reshape(-1)
    return held_late(
        lambda ago: flat[np.clip(now - ago, first, last) * (branches * joints) + place], steps
    )
