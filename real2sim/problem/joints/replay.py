"""Replays the commands of a log to many simulated robots at once,
each with other effects in its drives.

The base is held, so that legs are short open chains; near the measured motion their equation of
motion is linear with known coefficients (`saltus.sim.held_robot`). All windows and all sets of
effects advance together, in arrays of shape (windows, branches, joints, sets), the sets last
because they are most.
"""

from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.real2sim.problem.joints.drives import LEAST_LEVEL, DriveState, JointDrives
from saltus.real2sim.problem.joints.joint_mechanics import (
    HeldJointMotion,
    RotorPlay,
    bristle_slip,
    inverses_of,
    joint_accelerations,
    slowed_by_friction,
    with_inertia,
)

LEAST_REACH = 1e-9
"""Reach of bristles [rad] below which they are as good as rigid."""
DIVERGED = 1e3
"""[rad], [rad/s]: beyond it a simulation is not continued; nothing that moves gets there."""
_NONE = np.zeros(())


@dataclass(frozen=True, kw_only=True, eq=False)
class LoggedMotion:
    """Commands of a log and the equation of motion near its motion, on a uniform grid of instants.

    The drives compute their torque at these instants.
    """

    dt_s: float
    """Between instants."""
    every: int
    """Instants per row of the log."""
    law: Floats
    """kp q_des + kd dq_des [Nm], shape (instants, branches, joints)."""
    feedforward: Floats
    """[Nm], the same shape."""
    kp: Floats
    """Shape (branches, joints)."""
    kd: Floats
    """Shape (branches, joints)."""
    inverse_mass: Floats
    """Inverse of the matrix that stands for the mass matrix in a step of the midpoint rule
    [1/(kg m^2)], shape (instants, branches, joints, joints)."""
    offset: Floats
    """Halfway to the next instant [Nm], shape (instants, branches, joints)."""
    feedback: Floats
    """Stiffness and damping of the legs, shape (instants, branches, joints, 2 joints)."""
    armature: Floats
    """Claimed [kg m^2], shape (branches, joints)."""
    elapsed: Floats
    """Share of the log that is over, shape (instants,)."""
    sway: HeldJointMotion | None = None
    """Sway of the base; None where it is not known what hangs from it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointWindows:
    """Stretches of a joint log that are replayed on their own, from the measured state."""

    start: Indices
    """First instant, shape (windows,)."""
    first: Indices
    """First instant of the stretch that a window lies in."""
    last: Indices
    """Last instant of that stretch; beyond it commands are held and nothing is compared."""
    warm_up: int
    """Instants until the simulation has forgotten how it was started."""
    length: int
    """Instants after that."""
    position: Floats
    """At the start [rad], shape (windows, branches, joints)."""
    velocity: Floats
    """[rad/s], the same shape."""


SIGNALS = ("q", "dq", "tau_est")


def replay_windows(
    motion: LoggedMotion, windows: JointWindows, drives: JointDrives, averaged: int
) -> Floats:
    """Simulates every window with every set of effects;
    `averaged` rows, by which windows divide, make a sample.

    Returns:
        Means of `SIGNALS` over samples, shape (signals, windows, means, branches, joints, sets).
    """
    simulation = _Simulation(motion, windows, drives)
    per_mean = averaged * motion.every
    means = windows.length // per_mean
    sums = np.zeros((3, len(windows.start), means, *motion.kp.shape, drives.count))
    with np.errstate(over="ignore", invalid="ignore"):  # who diverges is clipped
        for k in range(windows.warm_up + windows.length):
            signals = simulation.measure(k)
            after = k - windows.warm_up
            if after >= 0 and after % motion.every == 0:
                for into, signal in zip(sums[:, :, after // per_mean], signals, strict=True):
                    into += signal
            simulation.advance(k)
    return sums / averaged


@dataclass(frozen=True, kw_only=True, eq=False)
class _FastLoop:
    """A drive that evaluates its law n times in a step of the replay:
    what its torque, a staircase, does over the step.

    The state is taken to follow a parabola; sums over the n stairs, with 1 - rate for 1/n, give the
    weights. Checked against a replay with n times as many steps.
    """

    mean: Floats
    """How late in the step, on average, the stairs know the state [s]."""
    moment: Floats
    """Moment of the staircase about the middle of the step [s^3]: an early push moves a joint
    farther than a late one."""
    ahead: Floats
    """From the last step's acceleration to the coming one's, in steps."""
    later: Floats
    """When, in the step, the acceleration is the one that counts [s]."""

    @classmethod
    def of(cls, rate: Floats, dt_s: float) -> "_FastLoop":
        later = (1.0 + rate) / 6.0
        return cls(
            mean=0.5 * dt_s * rate,
            moment=dt_s**3 / 12.0 * rate * (2.0 - rate),
            ahead=0.5 + later,
            later=dt_s * later,
        )


class _Simulation:
    """The state of all windows and sets."""

    def __init__(self, motion: LoggedMotion, windows: JointWindows, drives: JointDrives) -> None:
        self._motion, self._windows, self._drives = motion, windows, drives
        shape = (*windows.position.shape, drives.count)
        joints = shape[2]
        self._state = np.empty((shape[0], shape[1], 2 * joints, shape[3]))
        self._q, self._v = self._state[:, :, :joints], self._state[:, :, joints:]
        self._q[...] = windows.position[..., None]
        self._v[...] = windows.velocity[..., None]
        if drives.encoder_bias is not None:
            self._q -= drives.encoder_bias
        if drives.velocity_scale is not None:
            self._v /= 1.0 + drives.velocity_scale
        self._acceleration, self._earlier = np.zeros((2, *shape))
        self._loop = (
            None if drives.drive_rate is None else _FastLoop.of(drives.drive_rate, motion.dt_s)
        )
        self._kp, self._kd, self._claimed = (
            motion.kp[..., None],
            motion.kd[..., None],
            motion.armature[..., None],
        )
        rotor = self._claimed if drives.armature is None else self._claimed + drives.armature
        self._play = None if drives.backlash is None else RotorPlay(*drives.backlash, rotor, shape)
        self._drive_state = DriveState()
        self._rolled = None
        if drives.base_roll is not None and motion.sway is not None:
            self._rolled = motion.sway.rolled(*drives.base_roll)
        self._mobility = np.diagonal(motion.inverse_mass, axis1=2, axis2=3)[..., None]
        self._impulse, self._bent, self._believed = np.zeros((3, *shape))
        is_apart = drives.feedforward_delay is not None
        self._law = motion.law if is_apart else motion.law + motion.feedforward
        self._feedforward = motion.feedforward if is_apart else None

    def measure(self, k: int) -> tuple[Floats, Floats, Floats]:
        """Angles [rad] and velocities [rad/s] that encoders read, torque [Nm] that drives believe.

        They are those at instant k of all windows, shape (windows, branches, joints, sets).
        """
        drives = self._drives
        play = self._play
        q, v = (self._q, self._v) if play is None else play.logged(self._q, self._v)
        q, v = drives.sensed(q, v, self._drive_state)
        seen_q, seen_v = (q, v) if play is None else play.seen(q, v)
        sent = drives.sent(
            self._law,
            self._feedforward,
            self._windows.start + k,
            self._windows.first,
            self._windows.last,
        )
        fresh = sent - self._kp * seen_q - self._kd * seen_v
        if drives.between is None or k % 2 == 0:
            self._believed = fresh
        else:
            self._believed = self._believed + drives.between * (fresh - self._believed)
        return q, v, self._believed

    def advance(self, k: int) -> None:
        """On to instant k + 1."""
        motion, drives, q, v = self._motion, self._drives, self._q, self._v
        rows, dt = np.minimum(self._windows.start + k, self._windows.last), self._motion.dt_s
        # 1. torque until the next instant; a faster loop knows newer states as the step goes on
        torque = self._believed
        slope = self._falling(v)
        if self._loop is not None and slope is not None:
            torque = torque - self._loop.mean * slope
        elapsed = _NONE if drives.battery_sag is None else motion.elapsed[rows][:, None, None, None]
        torque = drives.delivered(torque, v, elapsed, self._drive_state)
        # 2. what resists it
        load = motion.offset[rows][..., None] + motion.feedback[rows] @ self._state
        if drives.joint_spring is not None or drives.end_stop is not None:
            load = load + drives.held_back(q + 0.5 * dt * v)
        if self._rolled is not None and motion.sway is not None:
            load = load + motion.sway.load(self._rolled, rows // motion.every)
        added = drives.armature
        if self._play is not None:
            if k == 0:
                q -= self._play.begun(torque)
            torque, missing = self._play.transmitted(torque)
            added = -missing if added is None else np.where(missing > 0.0, -self._claimed, added)
        if (
            drives.viscous_friction is not None
        ):  # the midpoint rule: at half of the step's change of velocity
            load = load + drives.viscous_friction * v
            added = 0.5 * dt * drives.viscous_friction + (0.0 if added is None else added)
        if self._drive_state.steepness is not None:
            stiff = self._drive_state.steepness
            change = dt * stiff * self._mobility[rows]  # of velocity in one step, relative
            # between the midpoint rule, for gentle slopes, and the implicit one, for steep ones: (3
            # + x) / (6 + x) is the weight with which a linear decay is exact, to second order
            added = (dt * (3.0 + change) / (6.0 + change)) * stiff + (
                0.0 if added is None else added
            )
        # 3. the legs
        inverse = motion.inverse_mass[rows]
        if added is None:
            acceleration = inverse @ (torque - load)
        if added is not None or drives.is_dry:
            inverse = inverses_of(inverse, drives.count)
        if added is not None:
            inverse = with_inertia(inverse, added)
            acceleration = joint_accelerations(inverse, torque - load)
        faster = v + dt * acceleration
        if drives.is_dry:
            faster = self._rubbed(faster, inverse)
            acceleration = (faster - v) / dt
        if self._play is not None:
            faster = self._play.moved(faster, acceleration, inverse, dt)
        q += (0.5 * dt) * (v + faster)
        if self._loop is not None and slope is not None:
            q += self._loop.moment * self._mobility[rows] * slope
        # by hand: `np.clip` takes several times as long for arrays of this size, most of it to look
        # at its arguments
        np.minimum(np.maximum(q, -DIVERGED, out=q), DIVERGED, out=q)
        np.minimum(np.maximum(faster, -DIVERGED, out=v), DIVERGED, out=v)
        self._earlier, self._acceleration = self._acceleration, acceleration

    def _rubbed(self, velocity: Floats, inverse: Floats) -> Floats:
        """Velocities after dry friction has acted for a step.

        Rigid bristles are those of the plant, which sees a velocity once a step; for others it is
        that in the midst of the step.
        """
        dt, drives = self._motion.dt_s, self._drives
        if drives.bristles is None:
            return slowed_by_friction(
                velocity, inverse, dt * drives.friction(self._v), self._impulse
            )
        reach = drives.bristles
        seen = self._v + 0.5 * dt * (reach > 0.0) * self._acceleration
        level = drives.friction(seen)
        give = reach / (np.maximum(level, LEAST_LEVEL) * dt**2)
        ways = (reach > 0.0) * dt * np.abs(seen) / np.maximum(reach, LEAST_REACH)
        slip = bristle_slip(give, self._bent, ways)
        velocity = slowed_by_friction(velocity, inverse, dt * level, self._impulse, *slip)
        self._bent = give * self._impulse
        return velocity

    def _falling(self, velocity: Floats) -> Floats | None:
        """By how much the law's torque falls in a second,
        on average over the coming step [Nm/s]; None if held.
        """
        loop = self._loop
        if loop is None:
            return None
        coming = self._acceleration + loop.ahead * (self._acceleration - self._earlier)
        return np.asarray(self._kp * (velocity + loop.later * coming) + self._kd * coming)
