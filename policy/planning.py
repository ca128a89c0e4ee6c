"""When to go, when to stop: the planner behind a process, with its judgement of the heightmap."""

from dataclasses import dataclass
from math import inf

import numpy as np

from policy.action import Action
from policy.observation import observe_message
from policy.scripted import ScriptedPlanner
from saltus.messages import ControllerMode, Heightmap, HeightmapStatus, MotionPlan, PlanStatus, RobotState
from saltus.topics import TOPICS

STAND_FIRST_S = 0.5  # the estimator and the memory of the heightmap settle while the robot stands
LOST_S = TOPICS["heightmap/heightmap"].invalid_age_s
"""A heightmap older than this, or this long since the last one arrived: it is gone."""


@dataclass(frozen=True, kw_only=True)
class PlannerMemory:
    """What the planning keeps between steps."""

    started_ns: int | None = None
    """Time of the first state."""
    seen_ok: bool = False
    """A heightmap of status OK has come."""
    stopped: str = ""
    """Why the planner has asked for a stop; it stays stopped."""


class Planning:
    """Plans for one robot; latches a stop when it cannot see."""

    def __init__(self, planner: ScriptedPlanner | None = None) -> None:
        self._planner = planner or ScriptedPlanner()
        self.memory = PlannerMemory()

    def step(self, state: RobotState, heightmap: Heightmap | None, silent_s: float) -> MotionPlan:
        """Plans for one state.

        Args:
            state: Of the robot.
            heightmap: The newest; None where none has come.
            silent_s: Time since a heightmap last arrived, in the run's clock [s]; infinite where none has.

        Returns:
            STAND until the first heightmap of status OK and the robot has stood; GO; STOP, for good, once the
            heightmap is invalid or lost after the planner has seen.
        """
        started_ns = state.time_ns if self.memory.started_ns is None else self.memory.started_ns
        age_s = 1e-9 * (state.time_ns - heightmap.time_ns) if heightmap is not None else inf
        self.memory = _remember(self.memory, started_ns, heightmap, max(age_s, silent_s))
        if self.memory.stopped:
            return _plan(state, PlanStatus.STOP, self.memory.stopped, None)
        if not self.memory.seen_ok or heightmap is None:
            return _plan(state, PlanStatus.STAND, "waiting for a heightmap of status ok", None)
        if state.time_ns - started_ns < 1e9 * STAND_FIRST_S:
            return _plan(state, PlanStatus.STAND, "settling", None)
        action = self._planner.step(observe_message(state), np.asarray(heightmap.height, dtype=np.float64))
        return _plan(state, PlanStatus.GO, "", action)


def _remember(memory: PlannerMemory, started_ns: int, heightmap: Heightmap | None, age_s: float) -> PlannerMemory:
    seen_ok = memory.seen_ok or (heightmap is not None and heightmap.status == HeightmapStatus.OK)
    stopped = memory.stopped
    if seen_ok and not stopped:
        if not age_s <= LOST_S:
            stopped = "heightmap_lost"
        elif heightmap is not None and heightmap.status == HeightmapStatus.INVALID:
            stopped = "heightmap_invalid"
    return PlannerMemory(started_ns=started_ns, seen_ok=seen_ok, stopped=stopped)


STANDING = Action(
    stepping_frequency_hz=np.asarray(1.0), velocity_x=np.asarray(0.0), velocity_z=np.asarray(0.0),
    pitch_rate=np.asarray(0.0), foot_residual_front=np.zeros(3), foot_residual_rear=np.zeros(3),
)  # fmt: skip
"""What a plan that is not GO carries; the controller does not use it."""


def _plan(state: RobotState, status: PlanStatus, reason: str, action: Action | None) -> MotionPlan:
    action = action or STANDING
    if state.mode in (ControllerMode.STOPPED, ControllerMode.DAMP) and status == PlanStatus.GO:
        status, reason = PlanStatus.STAND, f"the controller is in mode {ControllerMode(state.mode).name.lower()}"
    return MotionPlan(
        time_ns=state.time_ns,
        step=state.step,
        status=status,
        stepping_frequency_hz=float(action.stepping_frequency_hz),
        velocity_x=float(action.velocity_x),
        velocity_z=float(action.velocity_z),
        pitch_rate=float(action.pitch_rate),
        foot_residual_front=np.asarray(action.foot_residual_front),
        foot_residual_rear=np.asarray(action.foot_residual_rear),
        reason=reason,
    )
