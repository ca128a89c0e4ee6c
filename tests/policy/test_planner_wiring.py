"""The planner process on a bus."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from samples import ROBOT
from stage import Stage

from saltus.config import Pace, PlannerName, RunConfig
from saltus.grid import HEIGHTMAP_X
from saltus.policy.__main__ import body
from saltus.states import standing_state
from saltus.wire.messages import ControllerMode, Heightmap, HeightmapStatus, PlanStatus

STEP_NS = 10_000_000
STATE = replace(standing_state(ROBOT), base_height=0.27)
HEIGHTMAP = Heightmap(
    time_ns=0,
    step=0,
    x=HEIGHTMAP_X,
    height=np.full(30, -0.27),
    half_width_90=np.full(30, 0.01),
    status=HeightmapStatus.OK,
    depth_age_s=0.06,
    frame_id=0,
    model_id="0" * 16,
)


class PlannerStage(Stage):
    def __init__(self, pace: Pace, tmp_path: Path, planner: PlannerName = "scripted") -> None:
        self.epoch_ns = time.monotonic_ns()
        super().__init__(
            "policy",
            body,
            RunConfig(robot="go1", grid="line", pace=pace, planner=planner, epoch_ns=self.epoch_ns),
            tmp_path,
        )
        self.states = self.others.publisher("controller/state")
        self.heightmaps = self.others.publisher("heightmap/heightmap")
        self.plans = self.others.latest("policy/plan")

    def now_ns(self) -> int:
        return time.monotonic_ns() - self.epoch_ns


@pytest.mark.parametrize(
    ("planner", "heightmap_first"), [("scripted", True), ("scripted", False), ("learned", True)]
)
def test_lockstep_waits_for_the_heightmap_of_each_step(
    tmp_path: Path, planner: PlannerName, heightmap_first: bool
) -> None:
    with PlannerStage("lockstep", tmp_path, planner) as stage:
        for step in range(70):
            state = replace(STATE, step=step, time_ns=step * STEP_NS)
            heightmap = replace(HEIGHTMAP, step=step, time_ns=step * STEP_NS)
            if heightmap_first:
                stage.heightmaps.put(heightmap)
                stage.states.put(state)
            else:
                stage.states.put(state)
                assert stage.plans.take() is None
                stage.heightmaps.put(heightmap)
            done = stage.done.wait(timeout_s=5.0)
            plan = stage.plans.take()
            assert done is not None
            assert plan is not None
            assert done.message.step == plan.message.step == step
        assert plan.message.status == PlanStatus.GO
        stage.states.put(state)  # sent again: answered again, without another heightmap
        again = stage.plans.wait(timeout_s=5.0)
        assert again is not None
        assert again.message.step == 69
        assert again.message.velocity_x == plan.message.velocity_x


def test_real_time_plans_without_a_heightmap_and_says_when_they_end(tmp_path: Path) -> None:
    with PlannerStage("realtime", tmp_path) as stage:
        start_ns = stage.now_ns()
        for step in range(200):
            now_ns = stage.now_ns()
            if now_ns - start_ns < 700_000_000:
                stage.heightmaps.put(replace(HEIGHTMAP, step=step, time_ns=now_ns))
            stage.states.put(replace(STATE, step=step, time_ns=now_ns, mode=ControllerMode.RUN))
            plan = stage.plans.wait(timeout_s=5.0)
            assert plan is not None
            if plan.message.status == PlanStatus.STOP:
                break
            stage.events.wait(timeout_s=0.008)  # the pace of the states
        assert plan.message.status == PlanStatus.STOP
        assert "no heightmap" in plan.message.reason
        event = stage.events.wait(timeout_s=5.0)
        assert event is not None
        assert event.message.code == "heightmap_lost"
