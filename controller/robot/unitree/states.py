"""States of a robot as they come: which are taken over,
what is counted, and when the robot is lost.
"""

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from saltus.controller.robot.unitree.drives import MS
from saltus.controller.robot.unitree.messages import LOW_STATE, Message, is_intact
from saltus.errors import MessageError

TICK_MS = 2
"""Clock of a robot that says 500 states a second, from one to the next."""
LOST_S = 0.05
"""A robot that has said nothing new for 25 states is lost: on a busy computer the slowest of 1,000
comes 3.4 ms late, and 110 ms is what a fault may take altogether."""
DRIFT = 1e-4
"""Seconds per second by which two clocks may part: ten times what quartzes do."""
BUTTONS = slice(2, 4)
"""Bytes of `wireless_remote` with a bit for each button (Unitree's unitree_sdk2, gamepad)."""
MEASURED = ("imu_state", "motor_state")


@dataclass(frozen=True, kw_only=True)
class Health:
    """Counts of what came since the start."""

    states: int
    """States that were taken over."""
    lost: int
    """States that are missing, by the robot's clock."""
    bad: dict[str, int]
    """States that were not taken over, by the reason: crc, size, old."""
    late_s: float
    """How much later the newest came than the fastest did, by both clocks [s]."""


class StateWatch:
    """The newest state of one robot, and the first reason not to go on with it."""

    def __init__(self) -> None:
        self.message: Message | None = None
        """The newest state, shape ()."""
        self.fault = ""
        """Why the robot is lost, in words; empty while it is not. It stays."""
        self._arrived_s = 0.0
        self._states = self._missing = self._still = 0
        self._bad: Counter[str] = Counter()
        self._behind_s, self._late_s = math.inf, 0.0

    @property
    def health(self) -> Health:
        """Counts so far."""
        return Health(
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

    def lose(self, reason: str) -> None:
        """Gives up the robot; the first reason stays."""
        self.fault = self.fault or reason

    def _follow(self, message: Message, now_s: float) -> None:
        last = self.message
        if last is not None:
            passed_ms = int(message["tick"]) - int(last["tick"])
            if passed_ms <= 0:
                self._bad["old"] += 1
                return
            self._missing += max(0, passed_ms // TICK_MS - 1)
            if passed_ms > 1000.0 * LOST_S:
                self.lose(f"its clock has leapt by {passed_ms} ms")
            self._still = self._still + 1 if _equal(message, last) else 0
            if self._still * TICK_MS > 1000.0 * LOST_S:
                self.lose(f"its clock goes on, but {self._still} states say the same")
        if message["wireless_remote"][BUTTONS].any():
            self.lose("a button of the remote was pressed")
        self._behind_s += DRIFT * (now_s - self._arrived_s)
        self.message, self._arrived_s = message, now_s
        self._states += 1


def _equal(message: Message, before: Message) -> bool:
    """True where IMU and joints say the same to the bit, which noise never lets them do."""
    return all(message[part].tobytes() == before[part].tobytes() for part in MEASURED)
