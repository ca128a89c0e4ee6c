"""The simulated robot on DDS: in real time, at the speed of a run,
or tick by tick with its commands.
"""

import time

from saltus.clock import RunClock
from saltus.constants import PHYSICS_DT
from saltus.controller.robot.unitree.link import (
    ANSWERS,
    COMMANDS,
    REQUESTS,
    STATES,
    TRUTHS,
    UnitreeLink,
)
from saltus.controller.robot.unitree.simulated import SimulatedUnitree, holding_message
from saltus.robots.robot import Robot
from saltus.runtime.ticker import Ticker

CATCH_UP_TICKS = 500
"""1 s: the clock of a real robot does not fall behind where the machine stalls."""
ANEW_S = 0.1  # how often a lockstep run says a state again until it is answered


class OtherCommander:
    """Another program that commands the robot, too:
    it holds the stand pose, as the robot's own service would.
    """

    def __init__(self, robot: Robot, domain: int, interface: str | None) -> None:
        self._where = domain, interface
        self.payload = holding_message(robot)
        """The command, as it travels."""
        self._link: UnitreeLink | None = None

    def command(self) -> None:
        """Sends a command; joins the domain before the first."""
        if self._link is None:
            self._link = UnitreeLink(*self._where, sends=[COMMANDS])
        self._link.send(COMMANDS, self.payload)

    def close(self) -> None:
        """Leaves the domain, if it was joined."""
        if self._link is not None:
            self._link.close()
            self._link = None


class RobotServer:
    """One simulated robot that hears commands and tells its states over DDS."""

    def __init__(
        self, link: UnitreeLink, robot: SimulatedUnitree, stranger: OtherCommander
    ) -> None:
        self._link, self._robot, self._stranger = link, robot, stranger

    def realtime(self, clock: RunClock, until_s: float) -> None:
        """Says 500 states in each second of the clock,
        until the robot's time has come to `until_s`.
        """
        ticker = Ticker(1.0 / PHYSICS_DT, catch_up=CATCH_UP_TICKS, clock=clock)
        while self._robot.time_s < until_s:
            ticker.wait()
            for arrived in self._link.take(COMMANDS):
                self._robot.hear(arrived.payload)
            self._send(self._robot.step())
            self._serve()

    def lockstep(self, until_s: float) -> None:
        """Advances by 2 ms with each command, as fast as these come, and answers each."""
        last, said_s = self._robot.said(), 0.0  # noise must not depend on how long one waits
        awaited = True  # somebody who is to move the robot and has not said so yet
        while self._robot.time_s < until_s:
            taken = self._link.take(COMMANDS)
            for arrived in taken:
                self._robot.hear(arrived.payload)
                last = self._robot.step()
                self._send(last)
            self._serve()
            if taken:
                awaited = self._robot.is_commanded_by_others
                continue
            if awaited and time.monotonic() - said_s > ANEW_S:
                said_s = time.monotonic()
                self._send(last)
            self._link.wait(COMMANDS, ANEW_S)

    def _serve(self) -> None:
        """Answers requests, and lets others command the robot, or not any more."""
        for arrived in self._link.take(REQUESTS):
            for payload in self._robot.answer(arrived.payload):
                self._link.send(ANSWERS, payload)
        if self._robot.is_commanded_by_others:
            self._stranger.command()
        else:
            self._stranger.close()

    def _send(self, payloads: list[bytes]) -> None:
        self._link.send(TRUTHS, self._robot.truth())  # before the state, with which it is asked for
        for payload in payloads:
            self._link.send(STATES, payload)
