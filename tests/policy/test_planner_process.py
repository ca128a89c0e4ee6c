"""When the planner says STAND, GO and STOP: over the whole family of heightmap histories."""

from copy import deepcopy
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from samples import ROBOT

from saltus.arrays import Array
from saltus.grid import HEIGHTMAP_X, LINE
from saltus.loop.planner import Observation, observe
from saltus.plan import Plan
from saltus.policy.mover import AT_REST, MOST_TURN_RPS, Jumper, PlannerDecision
from saltus.policy.process import LOST_NS, STAND_NS, PlannerProcess
from saltus.policy.scripted import ScriptedPlanner
from saltus.robots.legs import LegKinematics
from saltus.states import standing_state
from saltus.wire.messages import (
    CommandMode,
    ControllerMode,
    DriveCommand,
    Heightmap,
    HeightmapStatus,
    MotionPlan,
    PlanStatus,
    RobotState,
)

STEP_NS = 10_000_000
_SEEN = (HeightmapStatus.OK, HeightmapStatus.DEGRADED)
STATE = replace(standing_state(ROBOT), base_height=0.27)
OBSERVED = observe(STATE, LegKinematics(ROBOT))


def state(step: int, mode: ControllerMode = ControllerMode.RUN) -> RobotState:
    return replace(STATE, step=step, time_ns=step * STEP_NS, mode=mode)


def heightmap(
    step: int, status: HeightmapStatus = HeightmapStatus.OK, rise: float = 0.0
) -> Heightmap:
    """Heights of level ground, or of a step 0.3 m ahead."""
    return Heightmap(
        time_ns=step * STEP_NS,
        step=step,
        x=HEIGHTMAP_X,
        height=np.where(HEIGHTMAP_X > 0.3, rise, 0.0) - 0.27,
        half_width_90=np.full(30, 0.01),
        status=status,
        depth_age_s=0.06,
        frame_id=step // 2,
        model_id="0" * 16,
    )


def run(
    statuses: list[HeightmapStatus | None],
    process: PlannerProcess,
    first: int = 0,
    mode: ControllerMode = ControllerMode.RUN,
) -> list[MotionPlan]:
    """One step for each entry; None where no heightmap arrives."""
    plans = []
    for step, status in enumerate(statuses, first):
        seen = None if status is None else heightmap(step, status)
        plans.append(process.step(state(step, mode), seen, step * STEP_NS))
    return plans


def jumper() -> Jumper:
    """A jumper for whom all states are one: what it is told of a state is the same at each."""
    return Jumper(ROBOT, ScriptedPlanner(ROBOT, LINE), lambda _: OBSERVED)


def going() -> tuple[PlannerProcess, int]:
    """A planner that has just said GO, and its next step."""
    return deepcopy(gone(), {id(ROBOT): ROBOT, id(LINE): LINE, id(OBSERVED): OBSERVED})


@cache
def gone() -> tuple[PlannerProcess, int]:
    process, steps = (
        PlannerProcess(LINE, jumper()),
        STAND_NS // STEP_NS + 1,
    )
    assert run([HeightmapStatus.OK] * steps, process)[-1].status == PlanStatus.GO
    return process, steps


def test_stands_until_it_has_stood_and_sees() -> None:
    stand_steps = STAND_NS // STEP_NS
    plans = run(
        [HeightmapStatus.OK] * (stand_steps + 5),
        PlannerProcess(LINE, Jumper(ROBOT, ScriptedPlanner(ROBOT, LINE))),
    )
    assert [plan.status for plan in plans] == [PlanStatus.STAND] * stand_steps + [PlanStatus.GO] * 5
    assert all(plan.reason for plan in plans[:stand_steps])
    assert not any(plan.reason for plan in plans[stand_steps:])


@pytest.mark.parametrize("status", [None, *(s for s in HeightmapStatus if s != HeightmapStatus.OK)])
def test_does_not_go_without_a_good_heightmap(status: HeightmapStatus | None) -> None:
    process = PlannerProcess(LINE, Jumper(ROBOT, ScriptedPlanner(ROBOT, LINE)))
    plans = run([status] * 200, process)
    assert {plan.status for plan in plans} == {PlanStatus.STAND}
    assert all(plan.reason for plan in plans)
    assert not process.notices
    assert run([HeightmapStatus.OK], process, first=200)[0].status == PlanStatus.GO


def test_every_history_of_three_heightmaps() -> None:
    """Once it goes: OK and DEGRADED keep it going,
    WARMING and INVALID stop it for good, single losses are bridged.
    """
    kinds = (None, *HeightmapStatus)
    fatal = (HeightmapStatus.WARMING, HeightmapStatus.INVALID)
    for history in product(kinds, repeat=3):
        process, first = going()
        plans = run(list(history), process, first)
        bad = [i for i, status in enumerate(history) if status in fatal]
        stop_at = bad[0] if bad else len(history)
        expected = [PlanStatus.GO] * stop_at + [PlanStatus.STOP] * (len(history) - stop_at)
        assert [plan.status for plan in plans] == expected, history
        assert [notice.code for notice in process.notices] == (["heightmap_invalid"] if bad else [])
        assert all(bool(plan.reason) == (plan.status != PlanStatus.GO) for plan in plans)


class Walking(Jumper):
    """Waits for commands, as one that walks does; slows down as long as it is told to."""

    waits = True

    def __init__(self, *, slows: bool) -> None:
        super().__init__(ROBOT, ScriptedPlanner(ROBOT, LINE), lambda _: OBSERVED)
        self.slow, self.asked = slows, AT_REST

    def plan(self, decision: PlannerDecision) -> MotionPlan:
        self.asked = decision.velocity
        return super().plan(decision)

    def slows(self, _state: RobotState) -> bool:
        return self.slow


class Catching(Walking):
    """Notes at which steps it had the robot."""

    follows = CommandMode.WALK

    def __init__(self) -> None:
        super().__init__(slows=True)
        self.took: list[int] = []

    def plan(self, decision: PlannerDecision) -> MotionPlan:
        self.took.append(decision.state.step)
        return super().plan(decision)


@pytest.mark.parametrize("slows", [True, False])
def test_a_robot_that_walks_stands_while_heights_are_lost_and_goes_on(slows: bool) -> None:
    """After every history: no STOP; velocity 0 on bad heights, that of the command on good ones."""
    kinds = (None, *HeightmapStatus)
    fatal = (HeightmapStatus.WARMING, HeightmapStatus.INVALID)
    wish = (0.8, 0.1, -0.2)
    for begins, *history in product(_SEEN, *2 * [kinds], [HeightmapStatus.OK]):
        mover = Walking(slows=slows)
        process, is_bad, onsets = PlannerProcess(LINE, mover), False, 0
        steps = STAND_NS // STEP_NS + 1
        for step, status in enumerate([begins] * steps + history):
            seen = None if status is None else heightmap(step, status)
            was_bad, is_bad = is_bad, status in fatal or (is_bad and status is None)
            onsets += is_bad and not was_bad
            said = replace(
                command(CommandMode.JUMP, step),
                velocity_x=wish[0], velocity_y=wish[1], yaw_rate=wish[2],
            )  # fmt: skip
            plan = process.step(state(step), seen, step * STEP_NS, said)
            if step < steps - 1:
                continue
            goes = slows or not is_bad
            assert plan.status == (PlanStatus.GO if goes else PlanStatus.STAND), history
            assert mover.asked == (AT_REST if is_bad else wish), history
            assert bool(plan.reason) == (not goes), history
        if slows:
            assert len(process.notices) == onsets


@pytest.mark.parametrize("mode", CommandMode)
def test_a_robot_that_walks_obeys_other_commands_while_heights_are_lost(mode: CommandMode) -> None:
    process, steps = PlannerProcess(LINE, Walking(slows=False)), STAND_NS // STEP_NS + 3
    for step in range(steps + 2):
        is_bad = step >= steps
        seen = heightmap(step, HeightmapStatus.INVALID if is_bad else HeightmapStatus.OK)
        said = command(mode if is_bad else CommandMode.JUMP, step)
        plan = process.step(state(step), seen, step * STEP_NS, said)
        if step == steps - 1:
            assert plan.status == PlanStatus.GO
    lies = mode == CommandMode.LIE_DOWN
    assert plan.status == (PlanStatus.LIE if lies else PlanStatus.STAND)


def test_every_history_of_three_heightmaps_while_the_robot_stands() -> None:
    """Nothing that was wrong before the robot has moved keeps it from going when all is well."""
    kinds = (None, *HeightmapStatus)
    fatal = (HeightmapStatus.WARMING, HeightmapStatus.INVALID)
    for history in product(kinds, repeat=3):
        process, first = going()
        plans = run(list(history), process, first, ControllerMode.STAND)
        going_on = True
        for status, plan in zip(history, plans, strict=True):
            going_on = (going_on and status not in fatal) or status == HeightmapStatus.OK
            assert plan.status == (PlanStatus.GO if going_on else PlanStatus.STAND), history
            assert bool(plan.reason) != going_on
        assert not process.notices
        assert (
            run([HeightmapStatus.OK], process, first + 3, ControllerMode.STAND)[0].status
            == PlanStatus.GO
        )


def test_says_within_110_ms_that_heightmaps_have_ended() -> None:
    process, first = going()
    plans = run([None] * 30, process, first)
    stopped = [i for i, plan in enumerate(plans) if plan.status == PlanStatus.STOP]
    assert stopped == list(range(stopped[0], 30))
    since_last_arrival = (stopped[0] + 1) * STEP_NS
    assert LOST_NS <= since_last_arrival <= 105_000_000  # 5 ms are left for the wait of the process
    assert [notice.code for notice in process.notices] == ["heightmap_lost"]


def test_old_heightmaps_are_no_heightmaps() -> None:
    process, first = going()
    plan = process.step(state(first), heightmap(first - 9), first * STEP_NS)
    assert plan.status == PlanStatus.STOP
    assert [notice.code for notice in process.notices] == ["heightmap_lost"]


def test_a_stop_is_final() -> None:
    process, first = going()
    plans = run([HeightmapStatus.INVALID] + [HeightmapStatus.OK] * 300, process, first)
    assert {plan.status for plan in plans} == {PlanStatus.STOP}
    assert len(process.notices) == 1


def test_the_same_step_again_gets_the_same_plan() -> None:
    process, first = going()
    plan = process.step(state(first), heightmap(first), first * STEP_NS)
    for again in (None, heightmap(first), heightmap(first, HeightmapStatus.INVALID)):
        assert process.step(state(first), again, first * STEP_NS + STEP_NS // 2) is plan


def test_plans_name_the_state_that_they_answer() -> None:
    process, first = going()
    for plan, step in zip(
        run([HeightmapStatus.OK] * 5, process, first), range(first, first + 5), strict=True
    ):
        assert (plan.step, plan.time_ns) == (step, step * STEP_NS)
        assert plan.foot_residual_front.shape == plan.foot_residual_rear.shape == (3,)
        assert 0.5 <= plan.stepping_frequency_hz <= 4.0


class Recalling(ScriptedPlanner):
    """Says when it was told to forget."""

    def __init__(self) -> None:
        super().__init__(ROBOT, LINE)
        self.begun: list[bool] = []

    def step(self, observation: Observation, heights: Array, fresh: object = False) -> Plan:
        self.begun.append(bool(fresh))
        return super().step(observation, heights)


def test_the_planner_forgets_whenever_the_robot_begins_to_go() -> None:
    planner, steps = Recalling(), STAND_NS // STEP_NS + 1
    process = PlannerProcess(LINE, Jumper(ROBOT, planner))
    run([HeightmapStatus.OK] * steps, process, mode=ControllerMode.STAND)
    run(
        [HeightmapStatus.INVALID] + 3 * [HeightmapStatus.OK],
        process,
        first=steps,
        mode=ControllerMode.STAND,
    )
    run([HeightmapStatus.OK] * 3, process, first=steps + 4)
    assert planner.begun == [True, True, *5 * [False]]


def command(mode: CommandMode, step: int) -> DriveCommand:
    return DriveCommand(
        time_ns=step * STEP_NS, step=step, mode=mode, velocity_x=0.0, velocity_y=0.0, yaw_rate=0.0
    )


@pytest.mark.parametrize("rate", [-2.0, -0.3, 0.0, 0.4, 1.0])
def test_a_robot_that_jumps_turns_as_commanded_and_no_faster_than_it_can(rate: float) -> None:
    process, first = going()
    limits = (-MOST_TURN_RPS, MOST_TURN_RPS)
    turning = {CommandMode.JUMP: float(np.clip(rate, *limits)), CommandMode.STAND: 0.0}
    for step, (mode, expected) in enumerate(turning.items(), first):
        said = replace(command(mode, step), yaw_rate=rate)
        plan = process.step(state(step), heightmap(step), step * STEP_NS, said)
        assert isinstance(plan, MotionPlan)
        assert plan.yaw_rate == expected


def test_every_history_of_three_commands() -> None:
    """Without a command it goes; then it does what the newest says,
    and stands 0.5 s after the last.
    """
    answer = {
        None: PlanStatus.GO,
        CommandMode.JUMP: PlanStatus.GO,
        CommandMode.LIE_DOWN: PlanStatus.LIE,
        CommandMode.STAND: PlanStatus.STAND,
        CommandMode.WALK: PlanStatus.STAND,
    }
    for history in product((None, *CommandMode), repeat=3):
        process, first = going()
        last, given = None, None
        for step, mode in enumerate(history, first):
            if mode is not None:
                last, given = mode, step
            said = None if mode is None else command(mode, step)
            plan = process.step(state(step), heightmap(step), step * STEP_NS, said)
            assert plan.status == answer[last], history
            assert bool(plan.reason) == (plan.status != PlanStatus.GO)
        if given is None:
            continue
        for step in (first + 3, *range(given + 49, given + 53), given + 60):
            plan = process.step(state(step), heightmap(step), step * STEP_NS)
            is_old = step - given > 50 and last != CommandMode.LIE_DOWN
            assert plan.status == (PlanStatus.STAND if is_old else answer[last]), (history, step)
        assert not process.notices


@pytest.mark.parametrize("mode", CommandMode)
def test_no_command_starts_a_robot_that_was_stopped(mode: CommandMode) -> None:
    process, first = going()
    run([HeightmapStatus.INVALID], process, first)
    plan = process.step(
        state(first + 1), heightmap(first + 1), (first + 1) * STEP_NS, command(mode, first + 1)
    )
    assert plan.status == PlanStatus.STOP


@pytest.mark.parametrize("mode", [None, *(m for m in CommandMode if m != CommandMode.JUMP)])
@pytest.mark.parametrize("waits", [0, 1, 30])
@pytest.mark.parametrize("rise", [0.15, -0.25])
def test_a_robot_that_jumps_on_stairs_is_caught_when_both_rear_feet_stand(
    mode: CommandMode | None, waits: int, rise: float
) -> None:
    """Also where commands end (None). Then it obeys, and may jump anew."""
    planner, walking = Recalling(), Catching()
    process = PlannerProcess(LINE, Jumper(ROBOT, planner, lambda _: OBSERVED), walking)
    begin, still = STAND_NS // STEP_NS + 1, 0 if mode is not None else 51

    def told(step: int, said: CommandMode | None, legs: int, mode: ControllerMode) -> PlanStatus:
        trusted = np.arange(4) >= 4 - legs  # the rear ones are the last two
        here = replace(state(step, mode), leg_trusted=trusted)
        wish = None if said is None else command(said, step)
        return process.step(here, heightmap(step, rise=rise), step * STEP_NS, wish).status

    for step in range(begin + 1):
        told(step, CommandMode.JUMP, 0, (ControllerMode.STAND, ControllerMode.RUN)[step >= begin])
    step = begin + still + waits
    for early in range(begin + 1, step + 1):
        assert told(early, mode, 1, ControllerMode.RUN) == PlanStatus.GO
    assert not walking.took
    assert told(step + 1, mode, 2, ControllerMode.RUN) == PlanStatus.GO
    assert told(step + 2, mode, 0, ControllerMode.WALK) == PlanStatus.GO
    assert walking.took == [step + 1, step + 2]
    walking.slow = False
    obeys = {CommandMode.LIE_DOWN: PlanStatus.LIE, CommandMode.WALK: PlanStatus.GO}
    assert told(step + 3, mode, 0, ControllerMode.WALK) == obeys.get(mode, PlanStatus.STAND)
    told(step + 4, CommandMode.JUMP, 4, ControllerMode.STAND)
    told(step + 5, CommandMode.JUMP, 4, ControllerMode.STAND)
    assert planner.begun.count(True) == 2
    assert len(walking.took) == 3


@pytest.mark.parametrize("rise", [0.0, 0.09, -0.09])
def test_a_robot_that_jumps_over_level_ground_lands(rise: float) -> None:
    walking = Catching()
    process, steps = PlannerProcess(LINE, jumper(), walking), STAND_NS // STEP_NS + 2
    for step in range(steps + 1):
        said = command(CommandMode.STAND if step == steps else CommandMode.JUMP, step)
        here = replace(state(step), leg_trusted=np.ones(4, bool))
        plan = process.step(here, heightmap(step, rise=rise), step * STEP_NS, said)
    assert plan.status == PlanStatus.STAND
    assert not walking.took


def test_a_command_from_the_future_moves_nobody() -> None:
    process, first = going()
    said = command(CommandMode.JUMP, first + 1000)
    plan = process.step(state(first), heightmap(first), first * STEP_NS, said)
    assert plan.status == PlanStatus.STAND
