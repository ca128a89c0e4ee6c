"""A stretch of a log of a robot that jumps: what its measured motion needs,
and what its drives are told.
"""

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.signal import lfilter

from saltus.arrays import AnyArray, Floats
from saltus.constants import PHYSICS_DT, POLICY_STEPS
from saltus.effects.body import BodyModel
from saltus.effects.motors import lag_weights
from saltus.errors import RecordingError
from saltus.real2sim.problem.body.windows import (
    JOINTS,
    POSE,
    RATES,
    VELOCITY,
    SegmentTrack,
    angular_velocity,
    late_steps,
    segment_track,
)
from saltus.real2sim.problem.joints.drives import DriveState, JointDrives
from saltus.real2sim.problem.log import gains_in_force
from saltus.real2sim.problem.problem import LogSegment
from saltus.recordings.run_log import RunLog
from saltus.robots.robot import LEGS, LINKS
from saltus.sim.measured_robot import MeasuredContact, MeasuredMotion, MeasuredRobot

Values = TypeVar("Values", bound=AnyArray)

BASE = 6
"""Degrees of freedom of a base."""
STILL = 0.02
"""Below it dry friction goes over from one sign to the other [rad/s]."""
UNEVEN = 0.1
"""Share of how the ground's force changes within a block that stays unknown: the base is measured
only at its ends."""
SMALLEST_PIVOT = 0.02
"""Smallest pivot of a leg's Jacobian [m]: a leg nearer to straight tells nothing of the force on
its foot."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JumpStretch:
    """One segment of a jump's log at n physics steps.

    Blocks of `size` steps begin at step `first`, where the base was measured.

    Attributes:
        motion: Measured.
        touch: Of the feet.
        commands: In force at each step: angles, velocities, kp, kd, feed-forward torques; shape (5,
            n, 4, 3).
        elapsed: Share of the log that is over, shape (n, 1, 1, 1).
        time_s: Shape (n,).
    """

    motion: MeasuredMotion
    touch: MeasuredContact
    commands: Floats
    elapsed: Floats
    time_s: Floats
    first: int
    size: int

    def blocks(self, values: Values) -> Values:
        """Values of steps, shape (n, ...), by blocks: shape (blocks, size, ...)."""
        count = (len(values) - self.first) // self.size
        part = values[self.first : self.first + count * self.size]
        return part.reshape(count, self.size, *values.shape[1:])  # type: ignore[return-value]

    @property
    def told(self) -> Floats:
        """Returns what drives give as they are told [Nm], shape (n, 12)."""
        q_des, dq_des, kp, kd, feedforward = self.commands.reshape(5, len(self.time_s), -1)
        angle, rate = self.motion.position[:, BASE + 1 :], self.motion.velocity[:, BASE:]
        return np.asarray(kp * (q_des - angle) + kd * (dq_des - rate) + feedforward)

    def torque(self, drives: JointDrives) -> Floats:
        """Returns what drives with these effects give along the measured motion [Nm],
        shape (n, 4, 3, sets).
        """
        n = len(self.time_s)
        instants, last = np.arange(n), np.full(n, n - 1)
        angle, rate, change = (
            values[:, column].reshape(n, len(LEGS), len(LINKS), 1)
            for values, column in (
                (self.motion.position, slice(BASE + 1, None)),
                (self.motion.velocity, slice(BASE, None)),
                (self.motion.acceleration, slice(BASE, None)),
            )
        )

        def sent(stream: Floats, fed: Floats) -> Floats:
            return drives.sent(stream, fed, instants, 0 * instants, last)

        none = np.zeros_like(self.commands[0])
        # A late packet is averaged by fields
        q_des, dq_des, kp, kd = (sent(each, none) for each in self.commands[:4])
        torque = kp * (q_des - angle) + kd * (dq_des - rate) + sent(none, self.commands[4])
        torque = _lagged(torque, drives)
        torque = replace(drives, actuator_lag=None).delivered(
            torque, rate, self.elapsed, DriveState()
        )
        rate = rate + 0.5 * PHYSICS_DT * change  # what resists does so all through a step
        torque = torque - drives.friction(rate) * np.clip(rate / STILL, -1.0, 1.0)
        if drives.joint_spring is not None:
            pull, stiffness = drives.joint_spring
            torque = torque + pull - stiffness * angle
        if drives.viscous_friction is not None:
            torque = torque - drives.viscous_friction * rate
        return torque if drives.armature is None else torque - drives.armature * change


def stretch_of(log: RunLog, segment: LogSegment, robot: MeasuredRobot) -> JumpStretch | None:
    """The stretch of a segment; None where it is shorter than a block."""
    now, base = segment_track(log, segment), log.base
    if base is None or len(now.time_s) < 3 * POLICY_STEPS:
        return None
    period_s = float(np.median(np.diff(base.time_s)))
    size = max(POLICY_STEPS, round(period_s / PHYSICS_DT))
    velocity = np.concatenate(
        [now.states[:, VELOCITY], _turning(now), now.states[:, RATES]], axis=1
    )
    position = np.concatenate([now.states[:, POSE], now.states[:, JOINTS]], axis=1)
    motion = MeasuredMotion(
        position=position[:-1],
        velocity=velocity[:-1],
        acceleration=np.diff(velocity, axis=0) / PHYSICS_DT,
    )
    time_s = now.time_s[:-1]
    near = np.abs((time_s[:size, None] - base.time_s) / PHYSICS_DT).min(axis=1)
    return JumpStretch(
        motion=motion,
        touch=robot.touch(motion.position),
        commands=_commands(log, time_s),
        elapsed=((time_s - log.joints.time_s[0]) / np.ptp(log.joints.time_s))[:, None, None, None],
        time_s=time_s,
        first=int(np.argmin(np.round(near, 3))),
        size=size,
    )


def _turning(now: SegmentTrack) -> Floats:
    """Rates of the base of a gyroscope, without its bias [rad/s], own frame, shape (n, 3).

    Orientations tell rates only as means, in which a landing is lost.

    Raises:
        RecordingError: there is no gyroscope, or it is late.
    """
    if now.gyro is None:
        raise RecordingError("no imu.csv: how a robot that jumps turns is not known to the instant")
    turning = angular_velocity(now.states[:, POSE][:, 3:])
    if late_steps(now, turning):
        raise RecordingError("the gyroscope is late: jumps need rates of the very instant")
    return now.gyro - np.mean(now.gyro - turning, axis=0)


class TorqueBalance:
    """The equations of motion of a stretch, without what is unknown of them:
    the forces of the ground.

    A leg that may stand feels an unknown force at its foot, three numbers, which its own three
    equations tell; what is left are the six of the base. They hold whatever the ground is like. A
    leg in the air has three of its own.

    Args:
        stretch: With n steps, b blocks.
        robot: That moves so.
        claimed: Its body.

    Attributes:
        is_air: Legs that are in the air all through a block, shape (b, 4).
        is_plain: Blocks in which nothing but feet touches the ground, shape (b,).
        uncertainty: Of force [N] and moment [Nm] on the base, as the ground's change within blocks,
            shape (b, 6).
    """

    def __init__(self, stretch: JumpStretch, robot: MeasuredRobot, claimed: BodyModel) -> None:
        self._stretch, self._robot, touch = stretch, robot, stretch.touch
        own = [touch.jacobian[:, i, :, BASE + 3 * i : BASE + 3 * i + 3] for i in range(len(LEGS))]
        inverse = np.linalg.pinv(np.stack(own, axis=1))  # foot's velocity -> joints'
        is_told = np.linalg.svd(inverse, compute_uv=False)[..., 0] < 1.0 / SMALLEST_PIVOT
        inverse *= (touch.foot & is_told)[..., None, None]
        self._on_base = np.einsum("nlab,nlia->nlbi", touch.jacobian[..., :BASE], inverse)
        unclear = touch.elsewhere | (touch.foot & ~is_told).any(axis=1)
        self.is_plain = np.all(~stretch.blocks(unclear), axis=1)
        self.is_air = np.all(~stretch.blocks(touch.foot), axis=1) & self.is_plain[:, None]
        lacking = robot.forces(stretch.motion, claimed)
        lacking[:, BASE:] -= stretch.told
        spread = np.linalg.norm(
            stretch.blocks(self._pushed(lacking)).std(axis=1).reshape(-1, 2, 3), axis=-1
        )
        self.uncertainty = UNEVEN * spread.repeat(3, axis=1)
        self._claimed = self._needed(claimed)

    def left(self, torque: Floats) -> Floats:
        """Rest of base and joints, (b, 18, sets), that drives' torques,
        (n, 4, 3, sets), leave to explain.
        """
        given = np.einsum("nlbi,nlis->nbs", self._on_base, torque)
        of_joints = torque.reshape(len(torque), -1, torque.shape[-1])
        lacking = self._stretch.blocks(np.concatenate([given, -of_joints], axis=1)).mean(axis=1)
        return self._claimed[..., None] + lacking

    def change(self, body: BodyModel) -> Floats:
        """Returns what another body changes of that, shape (b, 18)."""
        return self._needed(body) - self._claimed

    def _needed(self, body: BodyModel) -> Floats:
        """Means over blocks of what must act if drives gave nothing, shape (b, 18)."""
        force = self._robot.forces(self._stretch.motion, body)
        force[:, :BASE] -= self._pushed(force)
        return self._stretch.blocks(force).mean(axis=1)

    def _pushed(self, force: Floats) -> Floats:
        """Returns what the ground gives the base through legs that need these torques,
        shape (n, 18) -> (n, 6).
        """
        legs = force[:, BASE:].reshape(-1, len(LEGS), len(LINKS))
        return np.asarray(np.einsum("nlbi,nli->nb", self._on_base, legs))


def _commands(log: RunLog, time_s: Floats) -> Floats:
    """In force at each instant, shape (5, n, 4, 3)."""
    joints, (kp, kd) = log.joints, gains_in_force(log)
    none = np.zeros_like(joints.q)
    rates, fed = (none if values is None else values for values in (joints.dq_des, joints.tau_ff))
    row = np.searchsorted(joints.time_s, time_s + 0.05 * PHYSICS_DT, side="right") - 1
    told = np.stack([joints.commanded_q, rates, kp, kd, fed])
    return told[:, row].reshape(5, len(time_s), len(LEGS), len(LINKS))


def _lagged(torque: Floats, drives: JointDrives) -> Floats:
    """The torque after the lag of each joint, as the drives' law has it step by step.

    Shape (n, 4, 3, sets).
    """
    if drives.actuator_lag is None:
        return torque
    shape = (len(torque), *np.broadcast_shapes(torque.shape[1:], drives.actuator_lag.shape))
    lagged = np.array(np.broadcast_to(torque, shape))
    in_mean, at_end = (
        np.broadcast_to(weight, shape[1:])
        for weight in lag_weights(drives.actuator_lag, drives.dt_s)
    )
    for place in zip(*np.nonzero(in_mean), strict=True):
        asked, kept = lagged[(slice(None), *place)].copy(), at_end[place]
        state, _ = lfilter([1.0 - kept], [1.0, -kept], asked[:-1], zi=[kept * asked[0]])
        started = np.concatenate([asked[:1], state])
        lagged[(slice(None), *place)] = asked + in_mean[place] * (started - asked)
    return lagged
