"""A robot behind any backend on ground that is known to be level: it rises, stands, bounds, and stands again."""

import numpy as np

from saltus.constants import PHYSICS_DT, POLICY_STEPS
from saltus.controller.loop import ControlLoop
from saltus.controller.robot.backend import RobotBackend
from saltus.controller.tick import CompiledTick
from saltus.grid import HeightGrid
from saltus.joint_command import JointCommand
from saltus.loop.planner import Planner, observe
from saltus.plan import plan_message
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.wire.messages import ControllerMode, MotionPlan, PlanStatus

RISE_S = 2.0
"""A robot that lies gets up in this; one that stands already feels nothing of it."""
SOFT = 0.3
"""Share of the stand's stiffness with which it begins to rise."""


class LevelRun:
    """One robot, one call every 2 ms.

    The joints are led from where they are to the stand pose first. Then the leg controller has the
    robot, its watchdog too: it damps a robot that tips over.

    Args:
        backend: The robot, which has been reset.
        robot: Its kind.
        grid: Points of the planner.
        planner: Plans to go on with, once the robot has stood; None to stand.
    """

    def __init__(
        self, backend: RobotBackend, robot: Robot, grid: HeightGrid, planner: Planner | None = None
    ) -> None:
        self._backend, self._robot, self._grid, self._planner = backend, robot, grid, planner
        self._legs, self._loop = LegKinematics(robot), ControlLoop(robot, CompiledTick(robot))
        self._start = backend.read().measurement.joint_position
        self._plan: MotionPlan | None = None
        self._ticks = 0
        self.peak_power_w = 0.0
        """Greatest power of all joints together so far, by the drives' own torque [W]."""

    @property
    def mode(self) -> ControllerMode:
        """The controller's; STAND while the robot rises."""
        return self._loop.mode

    @property
    def time_s(self) -> float:
        """Since the start [s]."""
        return self._ticks * PHYSICS_DT

    def step(self, *, halt: bool = False) -> None:
        """Senses and commands; with `halt` the robot lands and stands.

        Raises:
            StackError: another program commands the robot.
        """
        reading = self._backend.read()
        power_w = float(reading.joint_torque @ reading.measurement.joint_velocity)
        self.peak_power_w = max(self.peak_power_w, power_w)
        if self.time_s < RISE_S:
            command = self._rising()
        else:
            self._loop.sense(reading)
            if self._ticks % POLICY_STEPS == 0:
                self._plan = self._planned(PlanStatus.STAND if halt else PlanStatus.GO)
            command = self._loop.act(self._plan, np.inf if self._plan is None else 0.0)
            self._loop.take_joint_log(0, 0)
        self._backend.write(command)
        self._ticks += 1

    def _rising(self) -> JointCommand:
        share = self.time_s / RISE_S
        led = 0.5 * (1.0 - np.cos(np.pi * share))
        one, gains = np.ones(12), self._robot.gains
        stiff = (SOFT + (1.0 - SOFT) * share) * gains.stand_kp
        return JointCommand(
            position=self._start + led * (self._robot.stand_pose - self._start),
            velocity=0.0 * one, torque=0.0 * one, kp=stiff * one, kd=gains.stand_kd * one,
        )  # fmt: skip

    def _planned(self, status: PlanStatus) -> MotionPlan | None:
        if self._planner is None:
            return None
        state = self._loop.state(round(1e9 * self.time_s), self._ticks // POLICY_STEPS)
        heights = np.full(self._grid.size, -state.base_height)
        begins = self._loop.mode == ControllerMode.STAND
        plan = self._planner.step(observe(state, self._legs), heights, begins)
        return plan_message(plan, status, time_ns=state.time_ns, step=state.step)
