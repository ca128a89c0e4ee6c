"""States of a robot as they come: which are taken over,
what is counted, and when the robot is lost or had better land.
"""

import math
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass

from saltus.controller.robot.unitree.drives import MS
from saltus.controller.robot.unitree.hips import HipWatch
from saltus.controller.robot.unitree.messages import LOW_STATE, UnitreeMessage, is_intact
from saltus.controller.robot.unitree.trouble import hardware_trouble, state_contradiction
from saltus.errors import MessageError
from saltus.robots.robot import Robot

TICK_MS = 2
"""Clock of a robot that says 500 states a second, from one to the next."""
LOST_S = 0.05
"""A robot that has said nothing new for 25 states is lost: on a busy computer the slowest of 1,000
comes 3.4 ms late, and 110 ms is what a fault may take altogether."""
LATE_S = 0.020
"""The leg law is tuned to drives that answer within 10 ms; at twice that it still stands and lands.
"""
LATE_STATES = 10
"""States that come late one after the other until it is no single packet any more."""
GAPS, GAPS_S = 4, 0.1
"""Places at which states are missing, and the time in which they are: a computer that was busy for
a moment leaves one."""
DRIFT = 1e-4
"""Seconds per second by which two clocks may part: ten times what quartzes do."""
BUTTONS = slice(2, 4)
"""Bytes of `wireless_remote` with a bit for each button (Unitree's unitree_sdk2, gamepad)."""
MEASURED = ("imu_state", "motor_state")


@dataclass(frozen=True, kw_only=True)
class LinkHealth:
    """Counts of the states of a robot that came over DDS since the start, of those that were lost,
    and of those that could not be used.
    """

    states: int
    """States that were taken over."""
    lost: int
    """States that are missing, by the robot's clock."""
    bad: dict[str, int]
    """States that were not taken over, by the reason: crc, size, old."""
    late_s: float
    """How much later the newest came than the fastest did, by both clocks [s]."""


class StateWatch:
    """The newest state of one robot, and the first reason not to go on with it.

    Args:
        robot: Its kind: what its motors, battery, joints and IMU say is judged, too. By default
            only whether states come.
    """

    def __init__(self, robot: Robot | None = None) -> None:
        self._robot = robot
        self._hips = None if robot is None else HipWatch(robot)
        self.message: UnitreeMessage | None = None
        """The newest state, shape ()."""
        self.fault = ""
        """Why the robot is lost, in words; empty while it is not. It stays."""
        self.concern = ""
        """Reason to land and stand, in words; empty while there is none. It stays."""
        self._gaps_ms: deque[int] = deque(maxlen=GAPS)
        self._states_late = 0
        self._arrived_s = 0.0
        self._states = self._missing = self._still = 0
        self._bad: Counter[str] = Counter()
        self._behind_s, self._late_s = math.inf, 0.0

    @property
    def health(self) -> LinkHealth:
        """Counts so far."""
        return LinkHealth(
            states=self._states, lost=self._missing, bad=dict(self._bad), late_s=self._late_s
        )

    def take(self, payloads: Iterable[bytes], now_s: float) -> bool:
        """Takes over what is intact and newer than the last; returns whether anything was."""
        before = self._states
        for payload in payloads:
            try:
                message = LOW_STATE.read([payload])[0]
            except MessageError as error:
                self._bad[error.reason] += 1
                continue
            if is_intact(message):
                self._follow(message, now_s)
            else:
                self._bad["crc"] += 1
        return self._states > before

    def judge(self, now_s: float) -> None:
        """Tells whether the robot is lost by now, in a clock that goes on as the robot's does."""
        if self.message is None:
            return
        age_s = now_s - self._arrived_s
        if age_s > LOST_S:
            self.lose(f"no new state has come for {1000 * age_s:.0f} ms")
        # Late is by how much our clock has gained on the robot's since the fastest state
        behind_s = self._arrived_s - MS * int(self.message["tick"])
        self._late_s = max(0.0, behind_s - self._behind_s)
        self._behind_s = min(self._behind_s, behind_s)
        if self._late_s > LOST_S:
            self.lose(f"its states come {1000 * self._late_s:.0f} ms late")
        self._states_late = self._states_late + 1 if self._late_s > LATE_S else 0
        if self._states_late > LATE_STATES:
            self.doubt(f"its states come {1000 * self._late_s:.0f} ms late")

    def lose(self, reason: str) -> None:
        """Gives up the robot; the first reason stays."""
        self.fault = self.fault or reason

    def doubt(self, reason: str) -> None:
        """Has the robot land; the first reason stays."""
        self.concern = self.concern or reason

    def _follow(self, message: UnitreeMessage, now_s: float) -> None:
        last = self.message
        if last is not None:
            passed_ms = int(message["tick"]) - int(last["tick"])
            if passed_ms <= 0:
                self._bad["old"] += 1
                return
            self._note_gap(int(message["tick"]), passed_ms)
            if passed_ms > 1000.0 * LOST_S:
                self.lose(f"its clock has leapt by {passed_ms} ms")
            self._still = self._still + 1 if _equal(message, last) else 0
            if self._still * TICK_MS > 1000.0 * LOST_S:
                self.lose(f"its clock goes on, but {self._still} states say the same")
            if self._robot is not None:
                self.lose(state_contradiction(message, last, self._robot))
        if self._hips is not None and not self._still and not self.fault:
            self.lose(self._hips.take(message))
        if self._robot is not None:
            self.doubt(hardware_trouble(message))
        if message["wireless_remote"][BUTTONS].any():
            self.lose("a button of the remote was pressed")
        self._behind_s += DRIFT * (now_s - self._arrived_s)
        self.message, self._arrived_s = message, now_s
        self._states += 1

    def _note_gap(self, tick_ms: int, passed_ms: int) -> None:
        missing = passed_ms // TICK_MS - 1
        if missing <= 0:  # a clock that is read a millisecond late leaves no gap
            return
        self._missing += missing
        self._gaps_ms.append(tick_ms)
        taken_ms = tick_ms - self._gaps_ms[0]
        if len(self._gaps_ms) == GAPS and taken_ms <= 1000.0 * GAPS_S:
            self.doubt(f"its states are missing at {GAPS} places within {taken_ms} ms")


def _equal(message: UnitreeMessage, before: UnitreeMessage) -> bool:
    """True where IMU and joints say the same to the bit, which noise never lets them do."""
    return all(message[part].tobytes() == before[part].tobytes() for part in MEASURED)
