from dataclasses import replace

import numpy as np
import pytest
from recorded_run import LATENCY_NS, MS, Glide, glide
from samples import KINEMATICS, ROBOT

from saltus import rotations
from saltus.config import TerrainConfig
from saltus.depth import MODEL_CAMERA, NOTHING, Intrinsics
from saltus.grid import HEIGHTMAP_X, LINE
from saltus.heightmap.evaluation.geometric import FOOT_GAIN, GeometricHeightmap
from saltus.heightmap.evaluation.height_edges import edge_errors
from saltus.heightmap.service.quantiles import UNKNOWN_HALF_WIDTH_M
from saltus.heightmap.service.replay import replay_predictor
from saltus.wire.messages import DepthFrame, Heightmap, HeightmapStatus, RobotState

FINE = Intrinsics(width=80, height=240, fx=211.4, fy=211.4, cx=40.0, cy=120.0)
"""The crop of a D435i that the camera process sends."""
SETTLED = 130  # steps until the robot has passed what the first image did not see
FLAT = TerrainConfig(terrain="flat")
STEP = TerrainConfig(terrain="step", height_m=0.15)
STAIRS = TerrainConfig(terrain="stairs", rise_m=0.08, run_m=0.3, steps=6)


def heights(maps: list[Heightmap]) -> np.ndarray:
    return np.array([heightmap.height for heightmap in maps])


def predict(
    run: Glide, states: list[RobotState] | None = None, foot_gain: float = 0.0
) -> list[Heightmap]:
    return replay_predictor(
        GeometricHeightmap(ROBOT, LINE, foot_gain=foot_gain),
        run.frames,
        states or run.states,
        run.arrival_ns,
    )


@pytest.fixture(scope="module")
def step_run() -> Glide:
    return glide(STEP)


@pytest.mark.sample(3)
@pytest.mark.parametrize("camera", [MODEL_CAMERA, FINE], ids=["model", "fine"])
@pytest.mark.parametrize("terrain", [FLAT, STEP, STAIRS], ids=lambda t: t.terrain)
def test_with_exact_odometry_heights_are_those_of_the_terrain(
    terrain: TerrainConfig, camera: Intrinsics
) -> None:
    run = glide(terrain, camera=camera)
    maps = predict(run)[SETTLED:]
    assert {heightmap.status for heightmap in maps} == {HeightmapStatus.OK}
    error = np.abs(heights(maps) - run.true_height[SETTLED:])
    # One point in seven is within a pixel of an edge, where a whole rise may be missed.
    assert np.quantile(error, 0.85) < 0.005
    edges = edge_errors(heights(maps), run.true_height[SETTLED:], HEIGHTMAP_X)
    if terrain is FLAT:
        assert edges.false == 0
    else:
        assert edges.found > 0.95
        assert edges.mean_m < 0.025


def test_heights_do_not_depend_on_the_heading(step_run: Glide) -> None:
    angle = 0.7
    turn = rotations.yaw_rotation(np.asarray(angle))
    half = np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])
    turned = [
        replace(
            state,
            velocity_base_in_world=turn @ state.velocity_base_in_world,
            quaternion_base_in_world=_product(half, state.quaternion_base_in_world),
        )
        for state in step_run.states[:150]
    ]
    expected = predict(step_run, step_run.states[:150])
    np.testing.assert_allclose(heights(predict(step_run, turned)), heights(expected), atol=1e-9)


def test_nothing_is_known_before_the_first_image(step_run: Glide) -> None:
    heightmap = GeometricHeightmap(ROBOT, LINE).step(step_run.states[0], None, 0)
    assert heightmap.status == HeightmapStatus.WARMING
    assert heightmap.frame_id == -1
    assert heightmap.half_width_90 == pytest.approx(UNKNOWN_HALF_WIDTH_M)


def test_a_place_is_less_sure_the_farther_the_nearest_point(step_run: Glide) -> None:
    predictor = GeometricHeightmap(ROBOT, LINE)
    for state in step_run.states[:6]:
        frame = step_run.frames[0] if state.step == 5 else None
        heightmap = predictor.step(state, frame, state.time_ns)
    unseen = HEIGHTMAP_X < 0.4  # the first image begins farther ahead
    assert (np.diff(heightmap.half_width_90[unseen]) < 0.0).all()
    assert heightmap.half_width_90[~unseen].max() < heightmap.half_width_90[unseen].min()


@pytest.mark.parametrize("value", [0, NOTHING, 5000])
def test_pixels_without_depth_in_range_say_nothing(step_run: Glide, value: int) -> None:
    frames = step_run.frames[:40]
    dead = [replace(f, depth=np.full_like(f.depth, value)) if f.frame_id % 3 else f for f in frames]
    sparse = [frame for frame in frames if frame.frame_id % 3 == 0]
    states = step_run.states[:80]
    a, b = (
        heights(
            replay_predictor(
                GeometricHeightmap(ROBOT, LINE),
                kept,
                states,
                [f.time_ns + LATENCY_NS for f in kept],
            )
        )
        for kept in (dead, sparse)
    )
    np.testing.assert_array_equal(a, b)


def test_a_frame_and_a_state_count_once(step_run: Glide) -> None:
    once, often = GeometricHeightmap(ROBOT, LINE), GeometricHeightmap(ROBOT, LINE)
    for state in step_run.states[:60]:
        frame = _due(step_run, state)
        expected = once.step(state, frame, state.time_ns)
        given = often.step(state, frame, state.time_ns)
        np.testing.assert_array_equal(given.height, expected.height)
        assert often.step(state, frame, state.time_ns) is given
        repeated = _due(step_run, step_run.states[max(state.step - 2, 0)])
        assert often.step(state, repeated, state.time_ns) is given


def test_silence_is_told_and_a_long_pause_forgets(step_run: Glide) -> None:
    predictor = GeometricHeightmap(ROBOT, LINE)
    for state in step_run.states[:60]:
        predictor.step(state, _due(step_run, state), state.time_ns)
    statuses = [
        predictor.step(state, None, state.time_ns).status for state in step_run.states[60:80]
    ]
    assert statuses == sorted(statuses)
    assert statuses[-1] == HeightmapStatus.INVALID
    late = replace(step_run.states[80], time_ns=step_run.states[79].time_ns + 1000 * MS)
    assert predictor.step(late, None, late.time_ns).half_width_90 == pytest.approx(
        UNKNOWN_HALF_WIDTH_M
    )


def test_standing_feet_take_away_vertical_drift() -> None:
    foot_height = KINEMATICS.position(ROBOT.stand_pose)[:, 2].mean()
    run = glide(FLAT, height_m=ROBOT.foot_radius - foot_height)
    drift = np.array([0.0, 0.0, -0.05])
    standing = np.ones(4, np.bool_)
    drifting = [
        replace(
            state, velocity_base_in_world=state.velocity_base_in_world + drift, leg_trusted=standing
        )
        for state in run.states
    ]
    errors = [
        np.abs(heights(predict(run, drifting, gain)) - run.true_height)[SETTLED:]
        for gain in (0.0, FOOT_GAIN)
    ]
    assert errors[0].mean() > 0.015
    assert errors[1].mean() < 0.5 * errors[0].mean()


def _due(run: Glide, state: RobotState) -> DepthFrame | None:
    frame_id, odd = divmod(state.step - 5, 2)
    return run.frames[frame_id] if frame_id >= 0 and not odd else None


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Quaternion product."""
    w, v = a[0] * b[0] - a[1:] @ b[1:], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])
    return np.array([w, *v])
