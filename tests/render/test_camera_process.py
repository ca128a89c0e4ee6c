import numpy as np
import pytest
from samples import ROBOT, level_truth

from saltus.config import TerrainConfig
from saltus.depth import MODEL_CAMERA, NOTHING, depth_in_millimetres
from saltus.depth_camera import SHIPPED
from saltus.effects.camera import CameraChain
from saltus.effects.image_delivery import CameraLatency, FrameDrop
from saltus.render.backends import make_renderer
from saltus.render.camera import RobotCamera
from saltus.render.exposure import PerfectExposure
from saltus.render.process import CameraProcess
from saltus.terrain.curriculum import make_terrain
from saltus.wire.messages import DepthFrame, GroundTruth

TERRAIN = make_terrain(TerrainConfig(terrain="stairs", difficulty=0.2))
STEP_NS = 10_000_000


def truth(step: int) -> GroundTruth:
    return level_truth(step, 0.01 * step, 0.3)


def camera(*effects: CameraLatency | FrameDrop, seed: int = 0) -> CameraProcess:
    return CameraProcess(
        SHIPPED["ideal"],
        PerfectExposure(make_renderer("embree", TERRAIN, RobotCamera.on(ROBOT))),
        CameraChain(effects),
        np.random.default_rng(seed),
    )


def run(process: CameraProcess, steps: int) -> dict[int, DepthFrame]:
    """Frames by the step at which they became due."""
    answers = {k: process.step(truth(k), k * STEP_NS) for k in range(steps)}
    return {k: frame for k, frame in answers.items() if frame is not None}


@pytest.mark.parametrize("latency_s", [0.0, 0.013, 0.03, 0.05, 0.06])
def test_every_second_step_is_seen_after_the_latency(latency_s: float) -> None:
    frames = run(camera(CameraLatency(latency=latency_s)), 40)
    late_steps = int(np.ceil(latency_s / 0.01 - 1e-9))
    assert {k: f.time_ns for k, f in frames.items()} == {
        k: (k - late_steps) * STEP_NS for k in range(late_steps, 40, 1) if (k - late_steps) % 2 == 0
    }
    assert [f.frame_id for f in frames.values()] == list(range(len(frames)))


def test_a_frame_is_the_image_at_its_capture_time() -> None:
    renderer = make_renderer("embree", TERRAIN, RobotCamera.on(ROBOT))
    for frame in run(camera(CameraLatency(latency=0.05)), 20).values():
        then = truth(frame.time_ns // STEP_NS)
        expected = renderer.render(
            then.position_base_in_world, then.quaternion_base_in_world, then.joint_position
        )
        np.testing.assert_array_equal(frame.depth, depth_in_millimetres(expected))
        assert (frame.fx, frame.cx, frame.depth.shape) == (
            MODEL_CAMERA.fx,
            MODEL_CAMERA.cx,
            (48, 16),
        )


def test_nothing_ahead_is_not_near() -> None:
    process = camera()
    frame = process.step(truth(10_000), 0)
    assert frame is not None
    assert (frame.depth == NOTHING).all()  # the course is long past


def test_a_repeated_step_changes_nothing() -> None:
    process = camera(CameraLatency(latency=0.02))
    run(process, 7)
    due = process.due
    assert process.step(truth(6), 6 * STEP_NS) is None
    assert process.due is due


def test_drops_and_jitter_repeat_with_the_seed() -> None:
    effects = (FrameDrop(fraction=0.3), CameraLatency(latency=0.045, jitter=0.01))
    first, again, other = (run(camera(*effects, seed=seed), 200) for seed in (1, 1, 2))
    assert {k: f.frame_id for k, f in first.items()} == {k: f.frame_id for k, f in again.items()}
    assert set(first) != set(other)
    assert 40 < len(first) < 95  # of 100 exposures, 30 % lost
    ages = [k * 0.01 - 1e-9 * f.time_ns for k, f in first.items()]
    assert min(ages) >= 0.035 - 1e-9
    assert max(ages) < 0.055 + 0.01


def test_waiting_ends_when_a_frame_is_due() -> None:
    process = camera(CameraLatency(latency=0.05))
    assert process.wait_s(0, 0.1) == pytest.approx(0.1)  # nothing is under way
    process.step(truth(0), 1_000_000)
    assert process.wait_s(1_000_000, 0.1) == pytest.approx(0.049)
    assert process.step(None, 50_000_000) is not None
    assert process.step(None, 51_000_000) is None


def test_a_frame_that_becomes_due_during_an_exposure_is_not_waited_for() -> None:
    """It would wait for the next truth, half a period later."""
    process = camera(CameraLatency(latency=0.021))
    process.step(truth(0), 0)
    assert process.step(truth(2), 20_000_000) is None  # the exposure goes on until 22 ms
    assert process.wait_s(22_000_000, 0.1) == 0.0
    assert process.step(None, 22_000_000) is not None


def test_missed_exposures_are_counted() -> None:
    process = camera()
    for step in (0, 2, 4, 10, 12):
        process.step(truth(step), step * STEP_NS)
    assert (process.exposures, process.overruns) == (5, 2)
