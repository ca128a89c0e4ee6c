"""A simulated robot over DDS in a run of the whole stack:
what a robot says, and the truth beside it.
"""

import time
from collections import deque
from typing import Self

import numpy as np

from saltus.arrays import Floats
from saltus.clock import RunClock
from saltus.config import RunConfig
from saltus.controller.robot.backend import CourseRobot, RobotReading, true_grid_heights
from saltus.controller.robot.unitree.limits import COURSE
from saltus.controller.robot.unitree.link import COMMANDS, STATES, TRUTHS, UnitreeLink
from saltus.controller.robot.unitree.robot import ANSWER_S, CONNECT_S, WAIT_S, UnitreeRobot
from saltus.controller.robot.unitree.truth import TruthSample, read_truth, tick_of
from saltus.errors import StackError
from saltus.joint_command import JointCommand
from saltus.setup import Setup
from saltus.wire.messages import GroundTruth

NOT_SIMULATED = (
    "the robot is no `saltus robot simulate`: it says states but not the truth about itself, by "
    "which `saltus up` simulates its camera; a real robot is moved by `saltus robot run`"
)
ELSEWHERE = (
    "the robot is simulated on another terrain than the run's: give both programs the same "
    "--terrain and sizes"
)

LAST_TICK = 2**32 - 1


class UnitreeOnCourse(CourseRobot):
    """One simulated robot on DDS, with the limits of a course (`COURSE`).

    Args:
        link: To the robot; it sends commands and takes states and truth.
        setup: Of the run.
        clock: The run's.
        lockstep: Waits for the answer to each command, and for the truth that belongs to it.
    """

    def __init__(self, link: UnitreeLink, setup: Setup, clock: RunClock, *, lockstep: bool) -> None:
        self._link = link
        self._robot = UnitreeRobot(link, setup.robot, clock, limits=COURSE, lockstep=lockstep)
        self._terrain, self._grid, self._lockstep = setup.terrain, setup.grid, lockstep
        self._truth: TruthSample | None = None
        self._waiting: deque[bytes] = deque()
        self._contacts = 0

    @classmethod
    def of_run(cls, setup: Setup, config: RunConfig, clock: RunClock) -> Self:
        """The robot that a run names; `StackError` where there is no such domain or interface."""
        lockstep, takes = config.pace == "lockstep", [STATES, TRUTHS]
        link = UnitreeLink(
            config.domain, config.interface, sends=[COMMANDS], takes=takes, reliable=lockstep
        )
        return cls(link, setup, clock, lockstep=lockstep)

    @property
    def fault(self) -> str:
        """See `CourseRobot.fault`."""
        return self._robot.fault

    @property
    def concern(self) -> str:
        """See `RobotBackend.concern`."""
        return self._robot.concern

    def reset(self) -> None:
        """Waits until the robot says states and truth.

        Raises:
            StackError: it does not, stands on another terrain, or is commanded by another program.
        """
        self._robot.reset()
        self._truth = None
        self._waiting.clear()
        self._await_truth(0, CONNECT_S, NOT_SIMULATED)

    def read(self) -> RobotReading:
        """See `UnitreeRobot.read`."""
        return self._robot.read()

    def write(self, command: JointCommand) -> None:
        """See `UnitreeRobot.write`."""
        self._robot.write(command)

    def truth(self, time_ns: int, step: int) -> GroundTruth:
        """See `CourseRobot.truth`; that of the newest state."""
        motion = self._newest().motion
        at = motion["position_base_in_world"], motion["quaternion_base_in_world"]
        heights = true_grid_heights(self._terrain, self._grid, *at)
        x, y = np.array(self._grid.x), np.array(self._grid.y)
        return GroundTruth(time_ns=time_ns, step=step, **motion, x=x, y=y, height=heights)

    def pose(self) -> tuple[Floats, Floats]:
        """See `CourseRobot.pose`."""
        motion = self._newest().motion
        return motion["position_base_in_world"], motion["quaternion_base_in_world"]

    def take_trunk_contact(self) -> bool:
        """See `CourseRobot.take_trunk_contact`."""
        before, self._contacts = self._contacts, self._newest().contacts
        return self._contacts > before

    def push(self, force: float) -> None:
        """Nobody can push a robot over its protocol."""

    def close(self) -> None:
        """See `UnitreeRobot.close`."""
        self._robot.close()

    def _newest(self) -> TruthSample:
        """Truth of the state that was last read, or, in real time,
        of one just before; of a lost robot the newest.
        """
        tick = LAST_TICK if self.fault else int(self._robot.message["tick"])
        if self._lockstep and not self.fault:
            return self._await_truth(tick, ANSWER_S, NOT_SIMULATED)
        self._take(tick)
        assert self._truth is not None  # noqa: S101 - `reset` has waited for one
        return self._truth

    def _await_truth(self, tick: int, seconds: float, otherwise: str) -> TruthSample:
        until_s = time.monotonic() + seconds
        while self._truth is None or self._truth.tick < tick:
            if time.monotonic() > until_s:
                raise StackError(otherwise)
            self._link.wait(TRUTHS, WAIT_S)
            self._take(tick)
        return self._truth

    def _take(self, tick: int) -> None:
        """Takes over the truth of a state, or the newest before it;
        of what comes first, whatever it is.
        """
        self._waiting += [arrived.payload for arrived in self._link.take(TRUTHS)]
        newest = None
        while self._waiting and (
            tick_of(self._waiting[0]) <= tick or self._truth is newest is None
        ):
            newest = self._waiting.popleft()
        if newest is not None:
            self._truth = read_truth(newest)
            if self._truth.terrain != self._terrain.fingerprint:
                raise StackError(ELSEWHERE)
