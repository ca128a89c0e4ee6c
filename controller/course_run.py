"""When a run is over: the trial is judged, the robot comes to a stand behind the finish."""

from dataclasses import dataclass

from saltus.arrays import Floats
from saltus.terrain.terrain import Terrain
from saltus.trial import Outcome, TrialMonitor
from saltus.wire.messages import ControllerMode

STOP_AFTER_FINISH_M = 0.2
"""The robot runs on so far, so that it passes the finish in full motion."""
STAND_S = 0.5
"""It then stands, or lies, this long before the run ends."""
AT_REST = (
    ControllerMode.STAND,
    ControllerMode.LIE,
    ControllerMode.STOPPED,
    ControllerMode.DAMP,
)
"""Modes in which a robot does not move on."""
AFTERMATH_LIMIT_S = 3.0
"""The run ends this long after its outcome at the latest: a landing and a stand take 1.5 s."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CourseState:
    """Outcome of a run on a course so far, and whether the robot is to halt."""

    outcome: Outcome | None
    """None while the trial goes on."""
    halt: bool
    """The robot is to stand now, whatever the plan says."""
    over: bool


class CourseRun:
    """Judges a run on a course, policy step by policy step: arrived, fallen, out of time."""

    def __init__(self, terrain: Terrain, time_limit_s: float) -> None:
        self._monitor = TrialMonitor(terrain, time_limit_s)
        self._halt_x = terrain.finish_x + STOP_AFTER_FINISH_M
        self._halt = False
        self._decided_s: float | None = None
        self._resting_s: float | None = None

    def step(
        self,
        time_s: float,
        position: Floats,
        quaternion: Floats,
        trunk_contact: bool,
        mode: ControllerMode,
    ) -> CourseState:
        """Takes in one sample.

        Arguments as for `TrialMonitor.step`, and the mode of the controller.
        """
        outcome = self._monitor.step(time_s, position, quaternion, trunk_contact)
        if outcome is None:
            return CourseState(outcome=None, halt=False, over=False)
        if self._decided_s is None:
            self._decided_s = time_s
        self._halt = self._halt or not outcome.success or float(position[0]) >= self._halt_x
        resting = mode in AT_REST
        if not (self._halt and resting):
            self._resting_s = None
        elif self._resting_s is None:
            self._resting_s = time_s
        rested = self._resting_s is not None and time_s - self._resting_s >= STAND_S
        late = time_s - self._decided_s >= AFTERMATH_LIMIT_S
        return CourseState(outcome=outcome, halt=self._halt, over=rested or late)
