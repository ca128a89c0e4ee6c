"""The 500 Hz loop of one robot as a pure class: sense, decide, act.

It knows no bus and no clock.
"""

from dataclasses import dataclass, replace
from math import isfinite

import numpy as np

from saltus.arrays import Floats
from saltus.constants import PHYSICS_DT
from saltus.controller.gait import GaitSignal, standing_gait
from saltus.controller.rising import RISE_S, rising_command
from saltus.controller.robot.backend import RobotReading
from saltus.controller.standing_feet import StandingFeet
from saltus.controller.tick import ActingResult, TickLaw
from saltus.controller.tracking import JointTargetTracking
from saltus.controller.watchdog import WatchdogInput, WatchdogState, watchdog_step
from saltus.controller.yaw_frame import CentroidalReference
from saltus.errors import SaltusError
from saltus.joint_command import JointCommand
from saltus.plan import REST, plan_message, plan_of
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.states import ProprioceptionArrays, robot_state_message, states_of
from saltus.wire.messages import (
    AnyPlan,
    ControllerMode,
    JointLog,
    JointPlan,
    MotionPlan,
    PlanStatus,
    RobotState,
)

FIRST_STAND_S = 1.0
"""Time for estimator, camera and heightmap to settle before the first GO is obeyed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Row:
    reading: RobotReading
    command: JointCommand


class ControlLoop:
    """Estimator, watchdog, braking and law of one robot:
    `sense(reading)`, then `state`, then `act(plan, age)`.

    With `rises` the joints are led from where they are to the stand pose first, whatever the plan
    says, and the law has the robot from then on.
    """

    def __init__(self, robot: Robot, tick: TickLaw | None = None, *, rises: bool = False) -> None:
        self._robot, self._tick = robot, tick or TickLaw(robot)
        self._rise_ticks = round(RISE_S / PHYSICS_DT) if rises else 0
        self._start: Floats | None = None
        self._estimate = self._tick.estimator.init((), robot.stand_pose)
        self._law_state = self._tick.law.init((), robot.stand_pose)
        self._watch = WatchdogState()
        self._gait: GaitSignal = standing_gait((), robot.stand_pose)
        self._settled = self._finite = False
        self._ground = self._tick.braking.init(LegKinematics(robot).position(robot.stand_pose))
        self._tracking = JointTargetTracking(robot, self._tick.compensation)
        self._standing = StandingFeet(robot)
        self._last: ActingResult | None = None
        self._caught = False
        self._ticks = 0
        self._reading: RobotReading | None = None
        self._attitude = (0.0, 0.0)
        self._heading = 0.0
        self._plan: tuple[MotionPlan, CentroidalReference] | None = None
        self._rows: list[_Row] = []

    @property
    def mode(self) -> ControllerMode:
        """Returns what the controller is doing."""
        return self._watch.mode

    @property
    def risen(self) -> bool:
        """False as long as it leads the joints to the stand pose."""
        return self._ticks >= self._rise_ticks

    def sense(self, reading: RobotReading) -> None:
        """Takes in what the robot measures now.

        It will hold the yaw of the first reading, or of that at the end of the rise; a robot that
        walks turns, and will hold the last one of its walk.
        """
        measured = reading.measurement
        if self._rise_ticks and self._ticks == self._rise_ticks:  # what it was before is no stand
            self._estimate = self._tick.estimator.init((), self._robot.stand_pose)
            self._reading = None
        sensing = self._tick.sense(measured, self._gait.trusted, self._estimate)
        if self._reading is None or self.mode == ControllerMode.WALK:
            self._heading = float(sensing.yaw)
        self._reading = reading
        self._attitude = (float(sensing.roll), float(sensing.pitch))
        self._estimate, self._finite = sensing.estimate, isfinite(sensing.total)

    def act(self, plan: AnyPlan | None, plan_age_s: float) -> JointCommand:
        """Decides the mode and computes the command.

        Before the first plan there is none, and its age is infinite.
        """
        reading = self._sensed_reading()
        if not self.risen:
            return self._logged(reading, self._rising(reading))
        self._watch = watchdog_step(
            self._watch,
            WatchdogInput(
                plan_age_s=plan_age_s,
                plan_status=PlanStatus.STAND if plan is None else plan.status,
                walks=isinstance(plan, JointPlan),
                roll=self._attitude[0],
                pitch=self._attitude[1],
                finite=self._finite,
                settled=self._settled,
                may_start=(self._ticks - self._rise_ticks) * PHYSICS_DT >= FIRST_STAND_S,
            ),
            PHYSICS_DT,
        )
        return self._logged(reading, self._step_law(plan))

    def state(self, time_ns: int, step: int, depth_due: int = -1) -> RobotState:
        """The robot as of the last `sense`, with the contacts of the last `act`."""
        return robot_state_message(
            self._states(),
            time_ns=time_ns,
            step=step,
            mode=self.mode,
            joint_torque=self._sensed_reading().joint_torque,
            depth_due=depth_due,
        )

    def take_joint_log(self, time_ns: int, step: int) -> JointLog:
        """The ticks since the last call; `time_ns` is the time of the first of them."""
        rows, self._rows = self._rows, []
        measured = [row.reading.measurement for row in rows]
        commands = [row.command for row in rows]
        return JointLog(
            time_ns=time_ns,
            step=step,
            dt_s=PHYSICS_DT,
            position=np.array([m.joint_position for m in measured]),
            velocity=np.array([m.joint_velocity for m in measured]),
            position_desired=np.array([c.position for c in commands]),
            velocity_desired=np.array([c.velocity for c in commands]),
            torque_feedforward=np.array([c.torque for c in commands]),
            torque_estimated=np.array([row.reading.joint_torque for row in rows]),
            kp=np.array([c.kp for c in commands]),
            kd=np.array([c.kd for c in commands]),
        )

    def _logged(self, reading: RobotReading, command: JointCommand) -> JointCommand:
        self._rows.append(_Row(reading=reading, command=command))
        self._ticks += 1
        return command

    def _rising(self, reading: RobotReading) -> JointCommand:
        if self._start is None:
            self._start = reading.measurement.joint_position
        return rising_command(self._start, self._robot, self._ticks * PHYSICS_DT)

    def _sensed_reading(self) -> RobotReading:
        if self._reading is None:
            raise SaltusError("the control loop must sense before it acts")
        return self._reading

    def _reference(self, plan: AnyPlan | None) -> CentroidalReference:
        message = plan if isinstance(plan, MotionPlan) else _NO_PLAN
        turns = self.mode == ControllerMode.RUN and message.yaw_rate != 0.0
        if turns:
            self._heading += message.yaw_rate * PHYSICS_DT
        if turns or self._plan is None or self._plan[0] is not message:
            reference = self._tick.reference(plan_of(message), np.asarray(self._heading))
            self._plan = (message, reference)
        return self._plan[1]

    def _states(self) -> ProprioceptionArrays:
        return states_of(self._sensed_reading().measurement, self._estimate, self._gait)

    def _step_law(self, plan: AnyPlan | None) -> JointCommand:
        # In WALK, too: a landing begins with what the law remembers of footholds and gait
        mode, reference = self._own_reference(self._reference(plan))
        acting = self._tick.act(reference, self._states(), self._law_state, self._ground, mode)
        self._law_state, self._ground, self._last = acting.law, acting.ground, acting
        self._gait, self._settled = acting.gait, bool(acting.settled)
        if mode not in (ControllerMode.WALK, ControllerMode.LANDING):
            return acting.command
        reading = self._sensed_reading()
        measured, torque = reading.measurement, reading.joint_torque
        down = self._tracking.contact(measured, torque)
        if mode == ControllerMode.LANDING:  # feet touch down when the schedule does not say so
            self._gait = replace(acting.gait, trusted=acting.gait.trusted & down)
        elif isinstance(plan, JointPlan):
            stands = self._standing.step(measured, torque, self._estimate.velocity_base_in_world)
            self._gait = replace(acting.gait, contact=down, trusted=stands)
            return self._tracking.command(plan)
        return acting.command

    def _own_reference(
        self, reference: CentroidalReference
    ) -> tuple[ControllerMode, CentroidalReference]:
        """Returns what the law is to do: while plans are late
        and until the robot is slow it bounds on and brakes.
        """
        last = self._last
        if last is None or self.mode not in (ControllerMode.COAST, ControllerMode.LANDING):
            self._caught = False
            return self.mode, reference
        self._caught = self.mode == ControllerMode.LANDING and (
            self._caught or bool(self._tick.braking.is_slow(last))
        )
        if self._caught:
            return ControllerMode.LANDING, self._tick.catches(reference, self._ground)
        height = np.asarray(self._estimate.base_height)
        return ControllerMode.COAST, self._tick.brakes(
            last, height, np.asarray(self._heading), self._ground
        )


_NO_PLAN = plan_message(REST, PlanStatus.STAND, reason="no plan yet")
