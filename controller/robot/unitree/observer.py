"""States of a Unitree that somebody else moves, as the heightmap service reads them."""

import numpy as np

from saltus.controller.estimator import Estimator
from saltus.controller.robot.backend import RobotReading
from saltus.controller.robot.unitree.drives import reading_of
from saltus.controller.robot.unitree.messages import UnitreeMessage
from saltus.controller.robot.unitree.states import TICK_MS, StateWatch
from saltus.controller.standing_feet import StandingFeet
from saltus.robots.robot import Robot
from saltus.states import ProprioceptionArrays, is_still, robot_state_message
from saltus.wire.messages import ControllerMode, RobotState

STATE_MS = 10
"""A robot of Saltus tells its state so often."""
LONGEST_MS = 100
"""After so long a silence the velocity is estimated anew: until then the last reading stands for
those that were lost."""
OFF_UNIT = 0.01
"""A quaternion whose norm differs more from 1 is no attitude."""


class StateObserver:
    """Estimates the velocity of a robot, and which of its feet stand, from the states that it says.

    The estimator is that of the leg controller. What the robot is told to do is not known: its mode
    is STAND while all feet stand and the base rests, else RUN.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot, self._estimator = robot, Estimator(robot)
        self._reading: RobotReading | None = None
        self._steps, self._taken_s = 0, 0.0
        self._begin()

    def take(self, payload: bytes, now_s: float) -> bool:
        """Takes a state; True where one is due to be told: every 10 ms by the robot's clock.

        Args:
            payload: As it travelled; it is left out if it is damaged, older than the last one, or
                no measurement, as before the IMU has started.
            now_s: When it came [s], by any clock.
        """
        last = self._watch.message
        if last is not None and now_s - self._taken_s > 1e-3 * LONGEST_MS:
            self._begin()  # the robot may have been switched on anew: its clock begins at 0
            last = None
        if not self._watch.take([payload], now_s) or self._watch.message is None:
            return False
        self._taken_s = now_s
        reading = reading_of(self._watch.message, self._robot)
        values = np.concatenate([*vars(reading.measurement).values(), reading.joint_torque])
        turned = float(np.linalg.norm(reading.measurement.quaternion_base_in_world))
        if not (np.isfinite(values).all() and abs(turned - 1.0) < OFF_UNIT):
            return False
        return self._follow(reading, self._watch.message, last)

    def state(self, time_ns: int) -> RobotState:
        """The newest state; its time in the run's clock is when it came."""
        assert self._reading is not None  # noqa: S101 - `take` has said that one is due
        measured, self._steps = self._reading.measurement, self._steps + 1
        velocity = self._estimate.velocity_base_in_world
        stands = self._trusted.all() and is_still(velocity, measured.angular_velocity_base)
        states = ProprioceptionArrays(
            **vars(measured),
            velocity_base_in_world=velocity,
            base_height=self._estimate.base_height,
            leg_contact=self._trusted,
            leg_progress=np.full(4, 0.5),
            leg_trusted=self._trusted,
            cycle=np.zeros(()),
        )
        return robot_state_message(
            states, time_ns=time_ns, step=self._steps - 1,
            mode=ControllerMode.STAND if stands else ControllerMode.RUN,
            joint_torque=self._reading.joint_torque,
        )  # fmt: skip

    def _begin(self) -> None:
        self._watch = StateWatch()
        self._estimate = self._estimator.init((), self._robot.stand_pose)
        self._standing, self._trusted = StandingFeet(self._robot), np.zeros(4, np.bool_)

    def _follow(
        self, reading: RobotReading, message: UnitreeMessage, last: UnitreeMessage | None
    ) -> bool:
        tick_ms = int(message["tick"])
        last_ms = tick_ms - TICK_MS if last is None else int(last["tick"])
        self._reading, measured = reading, reading.measurement
        for _ in range(max(1, min(tick_ms - last_ms, LONGEST_MS) // TICK_MS)):
            self._estimate = self._estimator.step(measured, self._trusted, self._estimate)
            self._trusted = self._standing.step(
                measured, reading.joint_torque, self._estimate.velocity_base_in_world
            )
        return tick_ms // STATE_MS != last_ms // STATE_MS
