"""A robot behind any backend on ground that is known to be level:
it rises, stands, bounds, and stands again.
"""

import numpy as np

from saltus.constants import PHYSICS_DT, POLICY_STEPS
from saltus.controller.control_loop import ControlLoop
from saltus.controller.robot.backend import RobotBackend
from saltus.controller.tick import CompiledTickLaw
from saltus.grid import HeightGrid
from saltus.loop.planner import Planner, observe
from saltus.plan import plan_message
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.wire.messages import ControllerMode, MotionPlan, PlanStatus


class LevelRun:
    """One robot on level ground that stands or bounds without a camera, one call every 2 ms.

    It rises first. Then the leg controller has the robot, its watchdog too: it damps a robot that
    tips over. A robot with a concern (`RobotBackend.concern`) lands and stands.

    Args:
        backend: The robot, which has been reset.
        robot: Its kind.
        grid: Points of the planner.
        planner: Plans to go on with, once the robot has stood; None to stand.
    """

    def __init__(
        self, backend: RobotBackend, robot: Robot, grid: HeightGrid, planner: Planner | None = None
    ) -> None:
        self._backend, self._grid, self._planner = backend, grid, planner
        self._legs = LegKinematics(robot)
        self._loop = ControlLoop(robot, CompiledTickLaw(robot), rises=True)
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
        self._loop.sense(reading)
        if self._ticks % POLICY_STEPS == 0 and self._loop.risen:
            self._plan = self._planned(
                PlanStatus.STAND if halt or self._backend.concern else PlanStatus.GO
            )
        self._backend.write(self._loop.act(self._plan, np.inf if self._plan is None else 0.0))
        self._loop.take_joint_log(0, 0)
        self._ticks += 1

    def _planned(self, status: PlanStatus) -> MotionPlan | None:
        if self._planner is None:
            return None
        state = self._loop.state(round(1e9 * self.time_s), self._ticks // POLICY_STEPS)
        heights = np.full(self._grid.size, -state.base_height)
        begins = self._loop.mode == ControllerMode.STAND
        plan = self._planner.step(observe(state, self._legs), heights, begins)
        return plan_message(plan, status, time_ns=state.time_ns, step=state.step)
