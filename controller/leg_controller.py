"""The leg controller: gait, swing, stance feed-forward, feedback, command.

One law, 500 Hz, numpy and torch.

All robots of a batch are in one mode. Headings: a plan says nothing about yaw, so the controller
itself turns the robot back to `CentroidalReference.heading` with a yaw rate proportional to the
error, and asks for no lateral velocity.
"""

from dataclasses import dataclass, replace

import numpy as np

from saltus.arrays import (
    Array,
    Constant,
    Flags,
    Joints,
    LegFlags,
    Legs,
    Scalars,
    Vectors,
    namespace,
    smooth_step,
)
from saltus.constants import PHYSICS_DT
from saltus.controller.compensation import Compensation
from saltus.controller.gait import GaitSignal, GaitState
from saltus.controller.stance import ExactSolver, StanceLegs, StanceSolver
from saltus.controller.swing import SwingLegs
from saltus.controller.velocity_feedback import SpeedBrake, VelocityFeedback
from saltus.controller.yaw_frame import CentroidalReference, YawFrameBody, observe_body
from saltus.joint_command import JointCommand
from saltus.robots.legs import LegKinematics
from saltus.robots.resting_poses import RestingPoses
from saltus.robots.robot import Robot
from saltus.states import Proprioception
from saltus.wire.messages import ControllerMode

_STANDING = (ControllerMode.STAND, ControllerMode.STOPPED, ControllerMode.LIE)
_MOVING = (ControllerMode.RUN, ControllerMode.COAST)

# Numbers of the law that are no robot's
VELOCITY_STEP = Constant([1.0, 1.0, np.inf])
"""References are not taken to be further from the present velocity than this, yaw frame [m/s];
original."""
ANGULAR_STEP = Constant([np.inf, np.inf, 1.0])
"""References are not taken to be further from the present angular velocity than this [rad/s];
original."""
HEADING_GAIN = 1.0
"""Yaw rate by heading error [1/s]: with the yaw gain of 10 1/s in stance this is far from
oscillating."""
STAND_BLEND_S = 1.0
"""Time from the present pose to the standing pose; the original takes 1.5 s from the floor."""
LANDING_FREQUENCY_HZ = 2.0
"""Slowest stepping while landing: a flight phase is over within 0.3 s."""
SETTLED_SPEED_MPS = 0.3
"""A landing is over below this speed: v^2 / 2g = 5 mm of height, which the standing joints take
up."""
_YAW_AXIS = Constant([0.0, 0.0, 1.0])


@dataclass(frozen=True, kw_only=True, eq=False)
class LawState:
    """State of the leg controller's law between ticks."""

    gait: GaitState
    liftoff: Legs
    """Foot relative to the base when last in contact, yaw frame [m], shape (..., 4, 3)."""
    landed: LegFlags
    """Leg has come down since landing began, bool, shape (..., 4)."""
    mode: ControllerMode
    blend_from: Joints
    """Joint angles from which the standing pose is approached [rad], shape (..., 12)."""
    rest: Joints
    """Joint angles of the standing pose that is approached [rad], shape (..., 12)."""
    mode_time_s: float
    """Time in the present mode."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Diagnostics:
    """Details of a step of the leg controller: for estimator, braking, training and benchmarks."""

    gait: GaitSignal
    """With contacts as they are used: all four legs when standing."""
    body: YawFrameBody
    force: Joints
    """Planned forces on the feet, yaw frame [N], shape (..., 12); zero when standing."""
    tracking_cost: Scalars
    """Weighted distance of the planned acceleration from its reference, shape (...); zero when
    standing."""
    velocity_reference: Vectors
    """After clipping, yaw frame [m/s], shape (..., 3)."""
    angular_velocity_reference: Vectors
    """After clipping, yaw frame [rad/s], shape (..., 3)."""


class LegController:
    """Turns a plan and what is sensed into joint commands.

    The stance problem is by default solved exactly, robot by robot; training hands in a batched
    solver. What is known of the drives may be taken out of the commands.
    """

    def __init__(
        self,
        robot: Robot,
        solver: StanceSolver | None = None,
        compensation: Compensation | None = None,
    ) -> None:
        self._robot, self._gains, self._legs = robot, robot.gains, LegKinematics(robot)
        self._poses = RestingPoses(robot)
        self._swing = SwingLegs(robot)
        self._stance = StanceLegs(robot)
        self._solver = solver or ExactSolver(robot)
        self._compensation = compensation
        self._feedback = VelocityFeedback(robot)
        self._brake = SpeedBrake(robot)

    def init(self, batch: tuple[int, ...], like: Array) -> LawState:
        """State of robots that stand at the start of a gait.

        Arrays of the library, dtype and device of `like`.
        """
        xp = namespace(like)
        zeros = xp.zeros((*batch, 12), dtype=like.dtype, device=like.device)
        pose = zeros + Constant(self._robot.stand_pose).like(like)
        return LawState(
            gait=GaitState(phase=zeros[..., 0]),
            liftoff=self._legs.position(pose),
            landed=zeros[..., :4] > 0.0,
            mode=ControllerMode.STAND,
            blend_from=pose,
            rest=pose,
            mode_time_s=0.0,
        )

    def step(
        self,
        reference: CentroidalReference,
        sensed: Proprioception,
        state: LawState,
        mode: ControllerMode = ControllerMode.RUN,
    ) -> tuple[JointCommand, LawState, Diagnostics]:
        """One tick of 2 ms: the command, the next state, and the details of this step.

        The plan is read while running and coasting; of it, while landing, frequency and foot
        residual. A change of mode starts its blend or its landing.
        """
        command, state, diagnostics = self._commanded(reference, sensed, state, mode)
        return (
            (command if self._compensation is None else self._compensation(command)),
            state,
            diagnostics,
        )

    def _commanded(
        self,
        reference: CentroidalReference,
        sensed: Proprioception,
        state: LawState,
        mode: ControllerMode,
    ) -> tuple[JointCommand, LawState, Diagnostics]:
        """Returns what ideal drives are asked for."""
        body = observe_body(sensed, self._legs)
        state = self._entered(state, mode, sensed, body)
        if mode in _MOVING:
            return self._run(reference, sensed, body, state)
        if mode == ControllerMode.LANDING:
            return self._land(sensed, reference, body, state)
        command = self._damp(sensed) if mode == ControllerMode.DAMP else self._stand(sensed, state)
        return (command, *self._at_rest(body, state))

    def settled(self, state: LawState, diagnostics: Diagnostics) -> Flags:
        """True where a landing is over: all feet have come down and the body is at rest.

        Bool, shape (...).
        """
        xp = namespace(state.landed)
        body = diagnostics.body
        # 0.1 m from the centre to where legs are attached: angular speed as speed
        energy = xp.sum(body.velocity * body.velocity, axis=-1) + 0.01 * xp.sum(
            body.angular_velocity * body.angular_velocity, axis=-1
        )
        return xp.all(state.landed, axis=-1) & (energy < SETTLED_SPEED_MPS**2)

    def _entered(
        self, state: LawState, mode: ControllerMode, sensed: Proprioception, body: YawFrameBody
    ) -> LawState:
        if mode == state.mode:
            return state
        if mode in _MOVING and state.mode in _MOVING:
            return replace(state, mode=mode)
        xp = namespace(sensed.joint_position)
        return replace(
            state,
            gait=GaitState(phase=xp.zeros_like(state.gait.phase))
            if mode in _MOVING
            else state.gait,
            landed=state.landed | (state.mode in _STANDING),
            mode=mode,
            blend_from=sensed.joint_position,
            rest=self._rest(state, mode, body),
            mode_time_s=0.0,
        )

    def _rest(self, state: LawState, mode: ControllerMode, body: YawFrameBody) -> Joints:
        """The pose of the new mode; a robot that walked leaves its feet where it has put them."""
        if mode not in _STANDING:
            return state.rest
        if (state.mode, mode) == (ControllerMode.WALK, ControllerMode.STAND):
            return self._poses.over_feet(body.foot_yaw)
        lies = mode == ControllerMode.LIE
        return (self._poses.lying if lies else self._poses.standing)(body.foot_yaw)

    def _run(
        self,
        reference: CentroidalReference,
        sensed: Proprioception,
        body: YawFrameBody,
        state: LawState,
    ) -> tuple[JointCommand, LawState, Diagnostics]:
        gait = state.gait.advanced(reference.stepping_frequency, PHYSICS_DT)
        signal = gait.read(reference.stepping_frequency)
        state = replace(
            state,
            gait=gait,
            landed=state.landed & False,
            mode_time_s=state.mode_time_s + PHYSICS_DT,
        )
        return self._track(reference, sensed, body, state, signal)

    def _land(
        self,
        sensed: Proprioception,
        reference: CentroidalReference,
        body: YawFrameBody,
        state: LawState,
    ) -> tuple[JointCommand, LawState, Diagnostics]:
        """All legs are springs that reach for the ground at the capture point,
        in whatever order they touch it.

        Forces cannot be planned here: feet come down when the schedule does not say so. It still
        tells the estimator which feet to trust. The plan's foot residual is added, so that legs can
        follow a slope.
        """
        xp = namespace(body.roll)
        frequency = xp.maximum(
            reference.stepping_frequency, xp.zeros_like(body.roll) + LANDING_FREQUENCY_HZ
        )
        gait = state.gait.advanced(frequency, PHYSICS_DT)
        signal = gait.read(frequency)
        landed = state.landed | signal.contact
        signal = replace(signal, contact=landed, trusted=landed & (signal.trusted | state.landed))

        target = self._swing.capture_point(body, self._robot.stand_height) + reference.foot_residual
        zero = xp.zeros_like(sensed.joint_position)
        command = JointCommand(
            position=self._swing.joint_target(body, target, sensed.joint_position),
            velocity=zero,
            kp=zero + self._gains.landing_kp,
            kd=zero + self._gains.landing_kd,
            torque=zero,
        )
        return (
            command,
            *self._without_plan(body, replace(state, gait=gait, landed=landed), signal),
        )

    def _track(
        self,
        reference: CentroidalReference,
        sensed: Proprioception,
        body: YawFrameBody,
        state: LawState,
        signal: GaitSignal,
    ) -> tuple[JointCommand, LawState, Diagnostics]:
        """Swing, stance feed-forward, feedback, command."""
        xp = namespace(body.roll)
        contact = signal.contact
        standing = contact[..., None]

        liftoff = xp.where(standing, body.foot_yaw, state.liftoff)
        path = self._swing.nominal_path(
            body, liftoff, signal.progress, signal.stance_duration, sensed.base_height
        )
        swing_joint = self._swing.joint_target(
            body, path + reference.foot_residual, sensed.joint_position
        )

        velocity, angular_velocity = self._velocities(reference, body)
        acceleration = self._stance.acceleration_reference(body, velocity, angular_velocity)
        qp = self._stance.build_qp(body, acceleration, contact)
        force = self._solver.solve(qp)
        torque = self._stance.torque(body, force)

        joint_velocity = self._feedback.joint_velocity(body, velocity, angular_velocity)

        stance = xp.broadcast_to(standing, body.foot_yaw.shape).reshape(sensed.joint_position.shape)
        zero = xp.zeros_like(sensed.joint_position)
        command = JointCommand(
            position=xp.where(stance, sensed.joint_position, swing_joint),
            velocity=xp.where(stance, joint_velocity, zero),
            kp=xp.where(stance, zero, zero + self._gains.swing_kp),
            kd=xp.where(stance, zero + self._gains.stance_kd, zero + self._gains.swing_kd),
            torque=torque,
        )
        diagnostics = Diagnostics(
            gait=signal,
            body=body,
            force=force,
            tracking_cost=self._stance.tracking_cost(qp, force),
            velocity_reference=velocity,
            angular_velocity_reference=angular_velocity,
        )
        command = self._brake(command, sensed.joint_velocity)
        return command, replace(state, liftoff=liftoff), diagnostics

    def _velocities(
        self, reference: CentroidalReference, body: YawFrameBody
    ) -> tuple[Vectors, Vectors]:
        """Velocity references of a plan: turned to the heading,
        and no further from the present than allowed.
        """
        xp = namespace(body.roll)
        error = body.yaw - reference.heading
        error = error - 2.0 * np.pi * xp.round(error * (0.5 / np.pi))
        yaw_rate = -HEADING_GAIN * error
        wanted = reference.angular_velocity + yaw_rate[..., None] * _YAW_AXIS.like(error)
        step, angular_step = VELOCITY_STEP.like(error), ANGULAR_STEP.like(error)
        velocity = xp.clip(reference.velocity, body.velocity - step, body.velocity + step)
        return velocity, xp.clip(
            wanted, body.angular_velocity - angular_step, body.angular_velocity + angular_step
        )

    def _stand(self, sensed: Proprioception, state: LawState) -> JointCommand:
        xp = namespace(sensed.joint_position)
        measured = sensed.joint_position
        share = smooth_step((state.mode_time_s + PHYSICS_DT) / STAND_BLEND_S)
        zero = xp.zeros_like(measured)
        return JointCommand(
            position=state.blend_from + share * (state.rest - state.blend_from),
            velocity=zero,
            kp=zero + self._gains.stand_kp,
            kd=zero + self._gains.stand_kd,
            torque=zero,
        )

    def _damp(self, sensed: Proprioception) -> JointCommand:
        xp = namespace(sensed.joint_position)
        zero = xp.zeros_like(sensed.joint_position)
        return JointCommand(
            position=zero, velocity=zero, kp=zero, kd=zero + self._gains.damp_kd, torque=zero
        )

    def _at_rest(self, body: YawFrameBody, state: LawState) -> tuple[LawState, Diagnostics]:
        """State and diagnostics of a step without a schedule: every leg is in contact."""
        xp = namespace(body.roll)
        down = state.landed | True
        zero = xp.zeros_like(body.roll)
        signal = GaitSignal(
            contact=down,
            progress=xp.zeros_like(body.foot_yaw[..., 0]),
            trusted=down,
            cycle=state.gait.read(zero + 1.0).cycle,
            stance_duration=zero,
        )
        return self._without_plan(body, replace(state, landed=down), signal)

    def _without_plan(
        self, body: YawFrameBody, state: LawState, signal: GaitSignal
    ) -> tuple[LawState, Diagnostics]:
        """State and diagnostics of a step in which no forces are planned."""
        xp = namespace(body.roll)
        still = xp.zeros_like(body.velocity)
        diagnostics = Diagnostics(
            gait=signal,
            body=body,
            force=xp.zeros_like(body.foot_yaw.reshape((*body.foot_yaw.shape[:-2], 12))),
            tracking_cost=xp.zeros_like(body.roll),
            velocity_reference=still,
            angular_velocity_reference=still,
        )
        return replace(
            state, liftoff=body.foot_yaw, mode_time_s=state.mode_time_s + PHYSICS_DT
        ), diagnostics
