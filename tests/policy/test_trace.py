"""Why trials fail, told from made-up traces, one for each cause."""

import numpy as np
import pytest
from samples import ROBOT

from saltus.config import TerrainConfig
from saltus.policy.evaluation.trial_trace import STEP_S, FailureKind, TrialTrace, failure_of
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import FIRST_EDGE_X, Terrain, build_course
from saltus.trial import Outcome

STEPS = 100
STAIRS = make_terrain(TerrainConfig(terrain="stairs", rise_m=0.2))
GAP = make_terrain(TerrainConfig(terrain="gap", gap_m=0.5))
FELL = Outcome(success=False, cause="trunk_contact", time_s=1.0, distance_m=1.0, mean_speed_mps=1.0)


def standing(x: float = 0.0, *, loaded: bool = True, stance: bool = True) -> TrialTrace:
    """A robot whose feet stay on the ground at x."""
    flags = np.ones((STEPS, 4), dtype=np.bool_)
    foot = np.broadcast_to([x, 0.0, ROBOT.foot_radius], (STEPS, 4, 3)).copy()
    return TrialTrace(
        pose=np.tile([x, 0.0, ROBOT.stand_height, 1.0, 0.0, 0.0, 0.0], (STEPS, 1)),
        joint_position=np.tile(ROBOT.stand_pose, (STEPS, 1)),
        heights=np.full((STEPS, 30), -ROBOT.stand_height),
        foot=foot,
        stance=flags & stance,
        loaded=flags & loaded,
    )


def sliding() -> TrialTrace:
    trace = standing()
    trace.foot[..., 0] += 0.5 * STEP_S * np.arange(STEPS)[:, None]
    return trace


def going(terrain: Terrain, x: float, then_x: float, *, below: float = 0.0) -> TrialTrace:
    """Stands at x, and for its last 0.2 s with its front feet on the ground elsewhere,
    or that far below it.
    """
    trace = standing(x)
    trace.foot[-20:, :2, 0] = then_x
    trace.foot[..., 2] += terrain.height_at(trace.foot[..., 0], trace.foot[..., 1])
    trace.foot[-20:, :2, 2] -= below
    trace.loaded[-21:-19] = False  # in flight between
    return trace


def course(*pieces: tuple[float, float], last_top: float) -> Terrain:
    return build_course("course", {}, pieces, last_top=last_top, finish_behind=1.0)


def astray() -> TrialTrace:
    trace = standing()
    trace.foot[-5:, 0, 1] = STAIRS.arrays.half_size[0, 1] + 0.01
    return trace


CASES = {
    "slip": (sliding(), STAIRS),
    "trench": (going(GAP, GAP.first_edge_x - 0.1, GAP.first_edge_x + 0.2), GAP),
    "astray": (astray(), STAIRS),
    "edge_hit": (standing(STAIRS.first_edge_x - 0.03, loaded=False, stance=False), STAIRS),
    "fall_in_flight": (standing(loaded=False, stance=False), STAIRS),
    "fall_in_stance": (standing(), STAIRS),
}


@pytest.mark.parametrize("failure", CASES)
def test_every_cause_is_told_apart(failure: FailureKind) -> None:
    trace, terrain = CASES[failure]
    assert failure_of(ROBOT, FELL, trace, terrain) == failure


@pytest.mark.parametrize("case", CASES)
def test_a_success_has_no_cause_and_a_timeout_needs_no_trace(case: str) -> None:
    trace, terrain = CASES[case]
    late = Outcome(
        success=False, cause="time_limit", time_s=20.0, distance_m=1.0, mean_speed_mps=0.1
    )
    arrived = Outcome(success=True, cause="", time_s=3.0, distance_m=5.0, mean_speed_mps=1.5)
    assert failure_of(ROBOT, late, trace, terrain) == "timeout"
    assert failure_of(ROBOT, arrived, trace, terrain) == ""


def test_landings_are_where_feet_begin_to_bear() -> None:
    trace = standing(loaded=False)
    trace.loaded[40:60, 1] = True
    trace.loaded[80:, 2] = True
    assert trace.landings.tolist() == [[0.0, ROBOT.foot_radius]] * 2


DOWN = [-0.15 * i for i in range(1, 7)]
NO_TRENCHES = {
    "stairs_down": course(*((0.25, top) for top in DOWN[:-1]), last_top=DOWN[-1]),
    "irregular": course((0.22, -0.08), (0.4, -0.2), (0.3, -0.36), (0.25, -0.42), last_top=-0.6),
    "step_down": course(last_top=-0.6),
    "pyramid": course(*((0.25, 0.15 * min(i, 10 - i)) for i in range(1, 10)), last_top=0.0),
    "stairs": STAIRS,
    "ramp_up": make_terrain(TerrainConfig(terrain="ramp_up", slope_deg=30.0)),
    "ramp_down": make_terrain(TerrainConfig(terrain="ramp_down", slope_deg=30.0)),
    "hurdles": course((0.05, 0.2), (1.6, 0.0), (0.05, 0.2), last_top=0.0),
}


@pytest.mark.sample(6)
@pytest.mark.parametrize("kind", NO_TRENCHES)
@pytest.mark.parametrize("way", [-0.3, 0.1, 0.6])
def test_ground_that_leads_down_or_up_is_no_trench(kind: str, way: float) -> None:
    terrain = NO_TRENCHES[kind]
    for x in np.arange(FIRST_EDGE_X - 0.6, terrain.finish_x, 0.09):
        trace = going(terrain, x, x + way)
        assert failure_of(ROBOT, FELL, trace, terrain) == "fall_in_stance", x
        trace.loaded[-20:] = False
        assert failure_of(ROBOT, FELL, trace, terrain) == "fall_in_flight", x


@pytest.mark.sample(3)
@pytest.mark.parametrize("kind", ["ramp_up", "ramp_down", "stairs_down", "step_down"])
@pytest.mark.parametrize("sole_m", [0.0, 0.02])
def test_a_foot_that_swings_close_to_a_slope_or_down_hits_no_edge(kind: str, sole_m: float) -> None:
    terrain = NO_TRENCHES[kind]
    for x in np.arange(FIRST_EDGE_X - 0.6, terrain.finish_x, 0.037):
        trace = going(terrain, x - 0.1, x, below=-sole_m)
        trace.stance[:] = False
        assert failure_of(ROBOT, FELL, trace, terrain) == "fall_in_stance", x


def test_who_has_jumped_over_a_wall_is_not_in_a_trench_before_the_next() -> None:
    walls = course((0.05, 0.2), (0.7, 0.0), (0.05, 0.2), last_top=0.0)
    trace = going(walls, FIRST_EDGE_X - 0.1, FIRST_EDGE_X + 0.3)
    assert failure_of(ROBOT, FELL, trace, walls) == "fall_in_stance"


@pytest.mark.parametrize("level", [-0.3, 0.0, 0.4])
@pytest.mark.parametrize("beyond", [-0.2, 0.0, 0.2])
@pytest.mark.parametrize(("width", "depth"), [(0.3, 0.15), (0.5, 0.4), (1.2, 0.4)])
def test_a_trench_is_one_in_ground_of_any_level(
    level: float, beyond: float, width: float, depth: float
) -> None:
    terrain = course(
        (2.0, level), (width, level + min(0.0, beyond) - depth), last_top=level + beyond
    )
    rim = FIRST_EDGE_X + 2.0
    for inside in np.linspace(0.02, width - 0.05, 5):
        fallen = going(terrain, rim - 0.1, rim + inside)
        assert failure_of(ROBOT, FELL, fallen, terrain) == "trench"
        above = going(terrain, rim - 0.1, rim + inside, below=-depth - 0.2)
        assert failure_of(ROBOT, FELL, above, terrain) == "fall_in_stance"
        out_again = going(terrain, rim - 0.1, rim + inside)
        out_again.foot[-20:] = out_again.foot[:20]
        assert failure_of(ROBOT, FELL, out_again, terrain) == "fall_in_stance"
