"""The controller process over a memory bus, with stand-ins for camera,
heightmap service and planner.
"""

import itertools
import json
from types import SimpleNamespace

import numpy as np
import pytest
from memory_bus import MemoryBus, MemoryHub
from samples import put_run
from stand_ins import PREFIX, StandIns, make_plan, of

from saltus.config import RunConfig, TerrainConfig
from saltus.controller import __main__ as process
from saltus.controller import lockstep
from saltus.controller.newest_plan import NewestPlan
from saltus.errors import StackError
from saltus.runtime.process import ProcessContext
from saltus.wire.bus import topic_of, unpack_sample
from saltus.wire.messages import (
    ControllerMode,
    Event,
    GroundTruth,
    JointLog,
    PlanStatus,
    RobotState,
)


class StoppedLater:
    """The context of a process that is told to stop at a time of its run."""

    def __init__(self, context, time_ns):
        self._context, self._time_ns = context, time_ns

    @property
    def stopped(self):
        return self._context.clock.now_ns() >= self._time_ns

    def __getattr__(self, name):
        return getattr(self._context, name)


def run_controller(tmp_path, pace="lockstep", seed=3, stopped_at_ns=None, **stand_ins):
    hub = MemoryHub()
    bus = MemoryBus(PREFIX, hub)
    stream = bus.stream()
    config = RunConfig(
        robot="go1",
        grid="line",
        terrain=TerrainConfig(terrain="flat"),
        seed=seed,
        time_limit_s=0.3,
        pace=pace,
    )
    context = ProcessContext("controller", config, put_run(tmp_path, config), bus)
    if stopped_at_ns is not None:
        context = StoppedLater(context, stopped_at_ns)
    with StandIns(hub, **stand_ins).running():
        process.body(context)
    return [(raw.key, unpack_sample(topic_of(raw.key), raw)[1]) for raw in stream.drain()]


def test_lockstep_run_is_complete_and_repeatable(tmp_path, monkeypatch):
    monkeypatch.setattr(lockstep, "RESEND_S", lockstep.SILENCE_LIMIT_S)  # also on a busy computer
    first, second = run_controller(tmp_path), run_controller(tmp_path)
    states = of(first, RobotState)
    steps = [state.step for state in states]
    assert steps == list(range(len(steps)))
    assert [state.time_ns for state in states] == [10_000_000 * step for step in steps]
    assert [state.depth_due for state in states] == [step // 2 for step in steps]
    assert [truth.step for truth in of(first, GroundTruth)] == steps
    logs = of(first, JointLog)
    assert [log.step for log in logs] == steps
    assert all(log.position.shape == (5, 12) for log in logs)
    outcomes = [event for event in of(first, Event) if event.code == "timeout"]
    assert len(outcomes) == 1
    assert json.loads(outcomes[0].detail)["cause"] == "time_limit"
    assert 80 <= len(steps) <= 85  # 0.3 s until the time limit, 0.5 s of standing
    for ours, theirs in zip(states, of(second, RobotState), strict=True):
        for name in (
            "quaternion_base_in_world",
            "joint_position",
            "velocity_base_in_world",
            "joint_torque",
        ):
            np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))


def test_a_robot_that_is_stopped_early_dates_what_it_says_until_it_rests(tmp_path):
    runs = [run_controller(tmp_path, stopped_at_ns=time_ns) for time_ns in (None, 50_000_000)]
    whole, stopped = (
        [event.time_ns for event in of(run, Event) if event.code == "timeout"] for run in runs
    )
    assert whole == stopped


def test_lost_questions_are_asked_again_without_changing_the_run(tmp_path, monkeypatch):
    monkeypatch.setattr(lockstep, "RESEND_S", 0.02)
    monkeypatch.setattr(lockstep, "POLL_S", 0.01)
    plain, lossy = run_controller(tmp_path), run_controller(tmp_path, deaf_to_first=True)
    assert len(of(lossy, GroundTruth)) > len(of(plain, GroundTruth))
    last = {state.step: state for state in of(lossy, RobotState)}
    for state in of(plain, RobotState):
        np.testing.assert_array_equal(last[state.step].joint_position, state.joint_position)


def test_time_in_which_the_controller_itself_stood_still_is_nobodys_silence(tmp_path, monkeypatch):
    """Its clock leaps by 10 s from look to look."""
    leaps = itertools.count(step=10)
    monkeypatch.setattr(lockstep, "time", SimpleNamespace(monotonic=lambda: float(next(leaps))))
    monkeypatch.setattr(lockstep, "POLL_S", 0.01)
    samples = run_controller(tmp_path, deaf_to_first=True)
    assert [
        event.code for event in of(samples, Event) if event.code in ("finished", "fell", "timeout")
    ] == ["timeout"]


@pytest.mark.parametrize("silent", ["render", "heightmap", "policy"])
def test_a_silent_process_is_named(tmp_path, monkeypatch, silent):
    monkeypatch.setattr(lockstep, "SILENCE_LIMIT_S", 0.2)
    monkeypatch.setattr(lockstep, "RESEND_S", 0.05)
    monkeypatch.setattr(lockstep, "POLL_S", 0.01)
    order = ("render", "heightmap", "policy")
    with pytest.raises(StackError, match=f"'{silent}'"):
        run_controller(tmp_path, alive=order[: order.index(silent)])


def test_realtime_run_ends_at_its_time_limit(tmp_path):
    samples = run_controller(tmp_path, pace="realtime")
    states = of(samples, RobotState)
    assert [state.step for state in states] == list(range(len(states)))
    assert all(state.depth_due == -1 for state in states)
    assert all(state.mode == ControllerMode.STAND for state in states)
    assert [
        event.code for event in of(samples, Event) if event.code in ("finished", "fell", "timeout")
    ] == ["timeout"]


def test_plans_say_once_that_they_are_lost_and_back(tmp_path):
    hub = MemoryHub()
    bus = MemoryBus(PREFIX, hub)
    stream = bus.stream()
    plans = NewestPlan(
        ProcessContext("controller", RunConfig(robot="go1", grid="line"), tmp_path, bus)
    )
    sender = MemoryBus(PREFIX, hub).publisher("policy/plan")
    assert plans.newest(0, halt=True) == (None, float("inf"))
    sender.put(make_plan(0, 0))
    ages = [plans.newest(now_ms * 1_000_000, halt=False)[1] for now_ms in (0, 50, 100, 101, 110)]
    np.testing.assert_allclose(ages, [0.0, 0.05, 0.1, 0.101, 0.11])
    sender.put(make_plan(11, 110_000_000))
    plan, age_s = plans.newest(112_000_000, halt=True)
    assert plan is not None
    assert (plan.status, age_s) == (PlanStatus.STAND, 0.0)
    events = [
        unpack_sample(topic_of(raw.key), raw)[1]
        for raw in stream.drain()
        if raw.key.startswith("event")
    ]
    assert [event.code for event in events] == ["plan_lost", "plan_back"]
