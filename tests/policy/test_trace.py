"""Why trials fail, told from made-up traces, one for each cause."""

import numpy as np
import pytest
from samples import ROBOT

from saltus.config import TerrainConfig
from saltus.policy.evaluation.trace import STEP_S, Failure, Trace, failure_of
from saltus.terrain.curriculum import make_terrain
from saltus.trial import Outcome

STEPS = 100
STAIRS = make_terrain(TerrainConfig(terrain="stairs", rise_m=0.2))
GAP = make_terrain(TerrainConfig(terrain="gap", gap_m=0.5))
FELL = Outcome(success=False, cause="trunk_contact", time_s=1.0, distance_m=1.0, mean_speed_mps=1.0)


def standing(x: float = 0.0, *, loaded: bool = True, stance: bool = True) -> Trace:
    """A robot whose feet stay on the ground at x."""
    flags = np.ones((STEPS, 4), dtype=np.bool_)
    foot = np.broadcast_to([x, 0.0, ROBOT.foot_radius], (STEPS, 4, 3)).copy()
    return Trace(
        pose=np.tile([x, 0.0, ROBOT.stand_height, 1.0, 0.0, 0.0, 0.0], (STEPS, 1)),
        joint_position=np.tile(ROBOT.stand_pose, (STEPS, 1)),
        heights=np.full((STEPS, 30), -ROBOT.stand_height),
        foot=foot,
        stance=flags & stance,
        loaded=flags & loaded,
    )


def sliding() -> Trace:
    trace = standing()
    trace.foot[..., 0] += 0.5 * STEP_S * np.arange(STEPS)[:, None]
    return trace


def into_the_trench() -> Trace:
    trace = standing(GAP.first_edge_x + 0.2, loaded=False)
    trace.foot[-5:, :2, 2] = -0.2
    return trace


CASES = {
    "slip": (sliding(), STAIRS),
    "trench": (into_the_trench(), GAP),
    "edge_hit": (standing(STAIRS.first_edge_x - 0.03, loaded=False, stance=False), STAIRS),
    "fall_in_flight": (standing(loaded=False, stance=False), STAIRS),
    "fall_in_stance": (standing(), STAIRS),
}


@pytest.mark.parametrize("failure", CASES)
def test_every_cause_is_told_apart(failure: Failure) -> None:
    trace, terrain = CASES[failure]
    assert failure_of(ROBOT, FELL, trace, terrain) == failure


@pytest.mark.parametrize("case", CASES)
def test_a_success_has_no_cause_and_a_timeout_needs_no_trace(case: str) -> None:
    trace, terrain = CASES[case]
    late = Outcome(success=False, cause="time_limit", time_s=20.0, distance_m=1.0, mean_speed_mps=0.1)
    arrived = Outcome(success=True, cause="", time_s=3.0, distance_m=5.0, mean_speed_mps=1.5)
    assert failure_of(ROBOT, late, trace, terrain) == "timeout"
    assert failure_of(ROBOT, arrived, trace, terrain) == ""


def test_landings_are_where_feet_begin_to_bear() -> None:
    trace = standing(loaded=False)
    trace.loaded[40:60, 1] = True
    trace.loaded[80:, 2] = True
    assert trace.landings.tolist() == [[0.0, ROBOT.foot_radius]] * 2
