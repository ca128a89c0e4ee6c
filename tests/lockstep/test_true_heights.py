"""A run whose heights are the simulator's: what the planner is told is the ground,
and the run repeats to the bit.
"""

import numpy as np
import pytest
from lockstep_run import check_repeats, recorded_run

from saltus.config import RunConfig, TerrainConfig
from saltus.loop.heights import TRUE_MODEL
from saltus.recordings.recording import Recording
from saltus.wire.messages import ControllerMode, GroundTruth, Heightmap, RobotState

LENGTH_S = 1.8


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    config = RunConfig(
        robot="go1",
        grid="line",
        terrain=TerrainConfig(terrain="stairs", rise_m=0.1),
        camera="ideal",
        heights="true",
        time_limit_s=LENGTH_S,
    )
    return recorded_run(tmp_path_factory.mktemp("run"), config)


def test_the_planner_is_told_the_ground_as_it_is_at_each_state(recording: Recording) -> None:
    truths = {truth.step: truth for truth in recording.of(GroundTruth)}
    told = list(recording.of(Heightmap))
    assert len(told) >= LENGTH_S * 100
    for each in told:
        np.testing.assert_array_equal(each.height, truths[each.step].height)
        np.testing.assert_array_equal(each.x, truths[each.step].x)
    assert {each.model_id for each in told} == {TRUE_MODEL}
    assert max(np.ptp(each.height) for each in told) > 0.09
    assert ControllerMode.RUN in {state.mode for state in recording.of(RobotState)}
    assert "heightmap" not in recording.models


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["heightmap", "render", "policy", "controller"])
def test_every_process_repeats_to_the_bit(recording: Recording, name: str) -> None:
    check_repeats(recording, name, 100)
