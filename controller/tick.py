"""The laws of one tick of the control loop: on numpy,
which is the reference, or compiled for one robot.

`CompiledTickLaw` has the same laws as straight-line Python on floats (`saltus.straight_line`),
which takes a fifth of the time. A test holds it to `TickLaw` over thousands of drawn robots
(tests/controller/test_tick.py).
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from saltus.arrays import Flags, LegFlags, Scalars, Vectors, namespace
from saltus.controller.braking import Braking, BrakingState
from saltus.controller.compensation import Compensation
from saltus.controller.estimator import Estimator, EstimatorState
from saltus.controller.gait import GaitSignal, standing_gait
from saltus.controller.leg_controller import LawState, LegController
from saltus.controller.stance import ExactSolver, StanceQP, StanceSolver
from saltus.controller.yaw_frame import CentroidalReference, reference_of
from saltus.joint_command import JointCommand
from saltus.plan import REST, Plan
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.rotations import roll_pitch_yaw, rotation_matrix
from saltus.states import (
    ProprioceptionArrays,
    SensorArrays,
    SensorReadings,
    standing_state,
    states_of,
)
from saltus.straight_line import straight_line
from saltus.symbols import Symbols, noted_call
from saltus.wire.messages import ControllerMode

ALIKE = {
    ControllerMode.COAST: ControllerMode.RUN,
    ControllerMode.STOPPED: ControllerMode.STAND,
    ControllerMode.LIE: ControllerMode.STAND,
    ControllerMode.WALK: ControllerMode.STAND,
}
"""Modes that the law treats as others."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SensingResult:
    """Results of the sensing half of a control tick: attitude and estimate."""

    roll: Scalars
    pitch: Scalars
    yaw: Scalars
    """[rad], shape (...)."""
    estimate: EstimatorState
    total: Scalars
    """Sum of all that is measured and estimated, shape (...): finite where all of it is."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyMotion:
    """How the robot's body moves, in the yaw frame."""

    pitch: Scalars
    """[rad], shape (...)."""
    velocity: Vectors
    """[m/s], shape (..., 3)."""
    angular_velocity: Vectors
    """[rad/s], shape (..., 3)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ActingResult:
    """Results of the acting half of a control tick: the command, and state for the next tick."""

    command: JointCommand
    law: LawState
    gait: GaitSignal
    body: BodyMotion
    ground: BrakingState
    settled: Flags
    """A landing is over, bool, shape (...)."""


class TickLaw:
    """The laws of a control tick (sense, then act) on numpy arrays, for any batch of robots."""

    def __init__(
        self,
        robot: Robot,
        compensation: Compensation | None = None,
        solver: StanceSolver | None = None,
    ) -> None:
        self.compensation = compensation
        self.estimator = Estimator(robot)
        self.law = LegController(robot, compensation=compensation, solver=solver)
        self.braking = Braking(robot)
        self.reference: Callable[[Plan, Scalars], CentroidalReference] = reference_of
        self.brakes: Callable[[ActingResult, Scalars, Scalars, BrakingState], CentroidalReference]
        self.brakes = self.braking.reference
        self.catches: Callable[[CentroidalReference, BrakingState], CentroidalReference] = (
            self.braking.catching
        )

    def sense(
        self, measured: SensorReadings, trusted: LegFlags, estimate: EstimatorState
    ) -> SensingResult:
        """Attitude and estimate.

        Legs that are `trusted`, bool, shape (..., 4), are known to stand.
        """
        xp = namespace(measured.joint_position)
        roll, pitch, yaw = roll_pitch_yaw(rotation_matrix(measured.quaternion_base_in_world))
        estimate = self.estimator.step(measured, trusted, estimate)
        known = (
            measured.quaternion_base_in_world, measured.angular_velocity_base,
            measured.acceleration_base,
            measured.joint_position, measured.joint_velocity, estimate.mean,
        )  # fmt: skip
        total = xp.sum(xp.concat(known, axis=-1), axis=-1)
        return SensingResult(roll=roll, pitch=pitch, yaw=yaw, estimate=estimate, total=total)

    def act(
        self,
        reference: CentroidalReference,
        states: ProprioceptionArrays,
        law: LawState,
        ground: BrakingState,
        mode: ControllerMode,
    ) -> ActingResult:
        """Command, and what is remembered for the next tick."""
        command, law, diagnostics = self.law.step(reference, states, law, mode)
        body = diagnostics.body
        return ActingResult(
            command=command,
            law=law,
            gait=diagnostics.gait,
            body=BodyMotion(
                pitch=body.pitch, velocity=body.velocity, angular_velocity=body.angular_velocity
            ),
            ground=self.braking.observe(diagnostics, ground),
            settled=self.law.settled(law, diagnostics),
        )


class CompiledTickLaw(TickLaw):
    """The laws of a control tick for one robot, compiled to Python on floats.

    Numpy does what they cannot: changes of mode, and numbers that are none.
    """

    def __init__(self, robot: Robot, compensation: Compensation | None = None) -> None:
        super().__init__(robot, compensation)
        laws = TickLaw(robot, compensation, NotedSolver(robot))
        pose = robot.stand_pose
        still, legs = standing_state(robot), standing_gait((), pose)
        measured = SensorArrays(
            **{field.name: getattr(still, field.name) for field in fields(SensorArrays)}
        )
        law, estimate = self.law.init((), pose), self.estimator.init((), pose)
        states = states_of(measured, estimate, legs)
        ground = self.braking.init(LegKinematics(robot).position(pose))
        zero = np.zeros(())
        reference = reference_of(REST, zero)
        last = super().act(reference, states, law, ground, ControllerMode.STAND)
        self.reference = straight_line(reference_of, REST, zero)
        self.brakes = _on_floats(self.brakes, last, zero, zero, ground)
        self.catches = _on_floats(self.catches, reference, ground)
        self._sense = straight_line(laws.sense, measured, legs.trusted, estimate)
        self._act = {
            mode: straight_line(laws.act, reference, states, replace(law, mode=mode), ground, mode)
            for mode in set(ControllerMode) - set(ALIKE)
        }

    def sense(
        self, measured: SensorReadings, trusted: LegFlags, estimate: EstimatorState
    ) -> SensingResult:
        """See `TickLaw.sense`."""
        try:
            sensing: SensingResult = self._sense(measured, trusted, estimate)
        except (ArithmeticError, ValueError):
            return super().sense(measured, trusted, estimate)
        return sensing

    def act(
        self,
        reference: CentroidalReference,
        states: ProprioceptionArrays,
        law: LawState,
        ground: BrakingState,
        mode: ControllerMode,
    ) -> ActingResult:
        """See `TickLaw.act`."""
        if mode != law.mode:
            return super().act(reference, states, law, ground, mode)
        try:
            acting: ActingResult = self._act[ALIKE.get(mode, mode)](
                reference, states, law, ground, mode
            )
        except (ArithmeticError, ValueError):
            return super().act(reference, states, law, ground, mode)
        return (
            acting
            if acting.law.mode == mode
            else replace(acting, law=replace(acting.law, mode=mode))
        )


def _on_floats(
    law: Callable[..., CentroidalReference], *examples: object
) -> Callable[..., CentroidalReference]:
    """The law for one robot: compiled, and itself where floats have no result."""
    compiled = straight_line(law, *examples)

    def step(*given: object) -> CentroidalReference:
        try:
            reference: CentroidalReference = compiled(*given)
        except (ArithmeticError, ValueError):
            return law(*given)
        return reference

    return step


class NotedSolver(ExactSolver):
    """The exact solver for a law that is compiled:
    it is called with the entries of the problem that feet stand for.
    """

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self._upper = np.triu_indices(12)
        places = np.zeros((12, 12), dtype=np.intp)
        places[self._upper] = np.arange(78)
        entries = np.maximum(places, places.T).reshape(-1)
        self._square = [entries[square] for square in self._square]

    def solve(self, qp: StanceQP) -> Symbols:
        """See `ExactSolver.solve`."""
        xp = namespace(qp.hessian)
        stands = xp.stack([qp.contact] * 3, axis=-1).reshape((12,))
        hessian = xp.where(stands[:, None] & stands[None, :], qp.hessian, 0.0)[self._upper]
        gradient = xp.where(stands, qp.gradient, 0.0)
        return noted_call(self._forces_of, xp.concat([qp.contact, hessian, gradient]), 12)

    def _forces_of(self, fr: bool, fl: bool, rr: bool, rl: bool, *entries: float) -> list[float]:
        """Forces by the feet that stand and by upper triangle and gradient of the problem."""
        pattern, forces = fr + 2 * fl + 4 * rr + 8 * rl, np.zeros(12)
        if pattern:
            numbers = np.array(entries)
            forces[self._columns[pattern]] = self._solve_one(numbers, numbers[78:], pattern)
        return forces.tolist()
