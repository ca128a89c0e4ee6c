"""Decides what the leg controller does when plans are late,
the planner is blind, or the robot tips over.
"""

from dataclasses import dataclass
from math import isfinite, radians

from saltus.wire.messages import ControllerMode, PlanStatus
from saltus.wire.topics import TOPICS

_AT_REST = (ControllerMode.STAND, ControllerMode.LIE)


COAST_AGE_S = 0.030
"""Two plans of 10 ms lost and the third late."""
LOST_AGE_S = TOPICS["policy/plan"].invalid_age_s
"""The planner is gone."""
TILT_LIMIT_RAD = radians(60.0)
"""Beyond this a robot is not upright: the definition of a failed trial."""
RISE_S = 1.0
"""A robot that lay goes after this at the soonest: the time in which it gets up
(`saltus.controller.leg_controller.STAND_BLEND_S`)."""
LANDING_LIMIT_S = 1.1
"""A landing is over after this at the latest, and so 1.2 s after the planner has gone. From 1.8 m/s
the robot brakes with one or two contacts of each pair of legs before sprung legs catch it: it does
not jump on, but no single contact could stop it."""


@dataclass(frozen=True, kw_only=True)
class WatchdogInput:
    """Everything that the watchdog decides the controller's mode by, at one tick."""

    plan_age_s: float
    """Age of the newest plan; infinite where there is none."""
    plan_status: PlanStatus
    """Plan status of the newest plan; `STAND` where there is none."""
    roll: float
    pitch: float
    """[rad]."""
    finite: bool
    """Everything measured and estimated is finite."""
    settled: bool
    """A landing has come to rest."""
    may_start: bool
    """The robot has stood long enough to obey its first GO."""
    walks: bool = False
    """The newest plan is one of joint targets."""


@dataclass(frozen=True, kw_only=True)
class WatchdogState:
    """State of the watchdog between ticks: the controller's mode, and since when."""

    mode: ControllerMode = ControllerMode.STAND
    mode_time_s: float = 0.0
    fault: bool = False
    """The landing under way was forced: it ends in STOPPED, not in STAND."""
    lay: bool = False
    """It lies, or gets up."""


def watchdog_step(state: WatchdogState, now: WatchdogInput, dt_s: float) -> WatchdogState:
    """One tick: the next state. STOPPED and DAMP are latched; DAMP wins over everything.

    STAND -> RUN on a fresh GO, -> WALK where its plan is of joint targets, -> LIE on a fresh LIE.
    LIE -> STAND on a fresh STAND or GO, and then it gets up for 1 s. RUN, WALK <-> COAST by the age
    of the plan. RUN, COAST, WALK -> LANDING when the plan is lost or says STOP (a fault), STAND or
    LIE (no fault); WALK -> STAND at once where the robot is at rest. LANDING -> STOPPED after a
    fault, else STAND. A plan that is lost or says STOP while the robot stands or lies changes
    nothing: it already does the safe thing.
    """
    mode, fault = _decide(state, now)
    time_s = state.mode_time_s + dt_s if mode == state.mode else 0.0
    lay = mode == ControllerMode.LIE or (
        state.lay and mode == ControllerMode.STAND and time_s < RISE_S
    )
    return WatchdogState(mode=mode, mode_time_s=time_s, fault=fault, lay=lay)


def _decide(state: WatchdogState, now: WatchdogInput) -> tuple[ControllerMode, bool]:
    if state.mode == ControllerMode.DAMP or not _upright(now):
        return ControllerMode.DAMP, True
    if state.mode == ControllerMode.STOPPED:
        return ControllerMode.STOPPED, True
    # Written so that an age that is not a number counts as lost.
    lost = not now.plan_age_s <= LOST_AGE_S or now.plan_status == PlanStatus.STOP
    if state.mode in _AT_REST:
        fresh = now.plan_age_s <= COAST_AGE_S and now.may_start
        rises = state.lay and state.mode == ControllerMode.STAND
        return (_from_rest(state.mode, now) if fresh and not rises else state.mode), False
    if state.mode == ControllerMode.LANDING:
        fault = state.fault or lost
        if now.settled or state.mode_time_s >= LANDING_LIMIT_S:
            return (ControllerMode.STOPPED if fault else ControllerMode.STAND), fault
        return ControllerMode.LANDING, fault
    if lost:
        return ControllerMode.LANDING, True
    if now.plan_status in (PlanStatus.STAND, PlanStatus.LIE):
        stands = state.mode == ControllerMode.WALK and now.settled
        return (ControllerMode.STAND if stands else ControllerMode.LANDING), False
    go = ControllerMode.WALK if now.walks else ControllerMode.RUN
    return (go if now.plan_age_s <= COAST_AGE_S else ControllerMode.COAST), False


def _from_rest(mode: ControllerMode, now: WatchdogInput) -> ControllerMode:
    """The next mode of a robot that stands or lies, on a fresh plan."""
    status = now.plan_status
    if mode == ControllerMode.LIE:
        return ControllerMode.STAND if status in (PlanStatus.STAND, PlanStatus.GO) else mode
    go = ControllerMode.WALK if now.walks else ControllerMode.RUN
    return {PlanStatus.GO: go, PlanStatus.LIE: ControllerMode.LIE}.get(status, mode)


def _upright(now: WatchdogInput) -> bool:
    if not (now.finite and isfinite(now.roll) and isfinite(now.pitch)):
        return False
    return abs(now.roll) <= TILT_LIMIT_RAD and abs(now.pitch) <= TILT_LIMIT_RAD
