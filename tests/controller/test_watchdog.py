import itertools
import math

import pytest

from saltus.controller.watchdog import WatchdogInput, WatchdogState, watchdog_step
from saltus.wire.messages import ControllerMode, PlanStatus

DT = 0.002
AGES = (0.0, 0.030, 0.031, 0.100, 0.101, math.inf, math.nan)
TILTS = ((0.0, 0.0), (1.0, -1.0), (1.06, 0.0), (0.0, -1.06), (math.nan, 0.0))


def inputs():
    for age, status, (roll, pitch), finite, settled, may_start, walks in itertools.product(
        AGES, PlanStatus, TILTS, *[(True, False)] * 4
    ):
        yield WatchdogInput(
            plan_age_s=age,
            plan_status=status,
            roll=roll,
            pitch=pitch,
            finite=finite,
            settled=settled,
            may_start=may_start,
            walks=walks,
        )


STATES = [
    WatchdogState(mode=mode, mode_time_s=time_s, fault=fault, lay=lay)
    for mode in ControllerMode
    for lay in (False, True)
    for time_s in (0.5, 5.0)
    for fault in (False, True)
]
CASES = list(itertools.product(STATES, inputs()))


def lost(now):
    return not now.plan_age_s <= 0.100 or now.plan_status == PlanStatus.STOP


def expected(state, now):
    """The table of transitions, written as a list of rules
    of which the first that applies decides.
    """
    upright = (
        now.finite and abs(now.roll) <= math.radians(60) and abs(now.pitch) <= math.radians(60)
    )
    fresh_go, fresh_lie, fresh_stand = (
        now.plan_status == status and now.plan_age_s <= 0.030
        for status in (PlanStatus.GO, PlanStatus.LIE, PlanStatus.STAND)
    )
    rests = now.plan_status in (PlanStatus.STAND, PlanStatus.LIE)
    over = now.settled or state.mode_time_s >= 1.1
    mode = ControllerMode
    moving = state.mode in (mode.RUN, mode.COAST, mode.WALK)
    rules = [
        (state.mode == mode.DAMP or not upright, mode.DAMP),
        (state.mode == mode.STOPPED, mode.STOPPED),
        (state.mode == mode.STAND and state.lay, mode.STAND),
        (state.mode == mode.STAND and fresh_go and now.may_start and now.walks, mode.WALK),
        (state.mode == mode.STAND and fresh_go and now.may_start, mode.RUN),
        (state.mode == mode.STAND and fresh_lie and now.may_start, mode.LIE),
        (state.mode == mode.STAND, mode.STAND),
        (state.mode == mode.LIE and (fresh_go or fresh_stand) and now.may_start, mode.STAND),
        (state.mode == mode.LIE, mode.LIE),
        (state.mode == mode.LANDING and not over, mode.LANDING),
        (state.mode == mode.LANDING and (state.fault or lost(now)), mode.STOPPED),
        (state.mode == mode.LANDING, mode.STAND),
        (state.mode == mode.WALK and rests and not lost(now) and now.settled, mode.STAND),
        (moving and (lost(now) or rests), mode.LANDING),
        (moving and now.plan_age_s <= 0.030, mode.WALK if now.walks else mode.RUN),
        (moving, mode.COAST),
    ]
    return next(result for applies, result in rules if applies)


def test_every_transition():
    for state, now in CASES:
        after = watchdog_step(state, now, DT)
        assert after.mode == expected(state, now), (state, now)
        if after.mode == state.mode:
            assert after.mode_time_s == state.mode_time_s + DT
        else:
            assert after.mode_time_s == 0.0


def test_a_robot_that_lay_goes_when_it_has_got_up():
    go = WatchdogInput(
        plan_age_s=0.0, plan_status=PlanStatus.GO, roll=0.0, pitch=0.0, finite=True, settled=False,
        may_start=True,
    )  # fmt: skip
    state, modes = WatchdogState(mode=ControllerMode.LIE, mode_time_s=3.0, lay=True), []
    for _ in range(round(1.5 / DT)):
        state = watchdog_step(state, go, DT)
        modes.append(state.mode)
    assert modes.count(ControllerMode.STAND) == pytest.approx(1.0 / DT, abs=2)
    assert modes[-1] == ControllerMode.RUN


def test_robots_only_jump_on_fresh_plans():
    for state, now in CASES:
        if watchdog_step(state, now, DT).mode == ControllerMode.RUN:
            assert now.plan_status == PlanStatus.GO
            assert now.plan_age_s <= 0.030
            assert now.finite


@pytest.mark.parametrize("mode", [ControllerMode.STOPPED, ControllerMode.DAMP])
def test_faults_are_latched(mode):
    for now in inputs():
        after = watchdog_step(WatchdogState(mode=mode, fault=True), now, DT).mode
        assert after in (mode, ControllerMode.DAMP)


def now(age, status=PlanStatus.GO, settled=False):
    return WatchdogInput(
        plan_age_s=age,
        plan_status=status,
        roll=0.0,
        pitch=0.0,
        finite=True,
        settled=settled,
        may_start=True,
    )


def test_a_planner_that_dies_leads_to_stopped_even_if_it_comes_back():
    state = watchdog_step(WatchdogState(), now(0.0), DT)
    modes = [state.mode]
    for tick in range(1, 60):
        state = watchdog_step(state, now(tick * DT), DT)
        modes.append(state.mode)
    assert [mode for mode, _ in itertools.groupby(modes)] == [
        ControllerMode.RUN,
        ControllerMode.COAST,
        ControllerMode.LANDING,
    ]
    assert modes.count(ControllerMode.COAST) == 35
    state = watchdog_step(state, now(0.0, settled=True), DT)
    assert state.mode == ControllerMode.STOPPED
    assert watchdog_step(state, now(0.0), DT).mode == ControllerMode.STOPPED


def test_a_landing_on_request_ends_in_a_stand_that_may_start_again():
    state = watchdog_step(WatchdogState(mode=ControllerMode.RUN), now(0.0, PlanStatus.STAND), DT)
    assert state.mode == ControllerMode.LANDING
    state = watchdog_step(state, now(0.0, PlanStatus.STAND, settled=True), DT)
    assert state.mode == ControllerMode.STAND
    assert watchdog_step(state, now(0.0), DT).mode == ControllerMode.RUN
