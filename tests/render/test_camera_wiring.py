"""The camera process on a bus."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples import level_truth
from stage import Stage

from saltus.config import Pace, RunConfig, TerrainConfig
from saltus.depth_camera import SHIPPED
from saltus.render.__main__ import body, build, warmed_camera
from saltus.render.exposure import PerfectExposure, StereoExposure
from saltus.wire.messages import DepthFrame, Done, GroundTruth


class CameraStage(Stage):
    def __init__(self, pace: Pace, tmp_path: Path, camera: str = "ideal") -> None:
        epoch_ns, terrain = time.monotonic_ns(), TerrainConfig(terrain="stairs")
        config = RunConfig(
            robot="go1",
            grid="line",
            pace=pace,
            terrain=terrain,
            epoch_ns=epoch_ns,
            seed=4,
            camera=camera,
        )
        super().__init__("render", body, config, tmp_path)
        self.truths = self.others.publisher("plant/truth")
        self.frames = self.others.latest("camera/depth")


def answered(stage: CameraStage, step: int) -> tuple[Done, DepthFrame | None]:
    stage.truths.put(level_truth(step, 0.01 * step, 0.3))
    done = stage.done.wait(timeout_s=5.0)
    assert done is not None
    frame = stage.frames.take()
    return done.message, None if frame is None else frame.message


def test_lockstep_answers_each_step_and_each_repetition(tmp_path: Path) -> None:
    with CameraStage("lockstep", tmp_path) as stage:
        newest = -1
        for step in range(30):
            done, frame = answered(stage, step)
            if frame is not None:
                newest = frame.frame_id
                # Latency is at least 30 ms, less the jitter
                assert frame.time_ns <= step * 10_000_000 - 25_000_000
            assert (done.step, done.frame_id, done.process) == (step, newest, "render")
            again, repeated = answered(stage, step)
            assert (again.step, again.frame_id) == (step, newest)
            assert (repeated is None) == (newest == -1)
            assert repeated is None or repeated.frame_id == newest
        assert newest >= 10


def test_images_of_a_seed_are_late_alike_whatever_the_errors_of_the_camera(tmp_path: Path) -> None:
    """A roll-out, whose chain of errors is another one,
    and a run then see the same images at the same steps.
    """
    arrived = []
    for camera in SHIPPED:
        with CameraStage("lockstep", tmp_path, camera) as stage:
            arrived.append([answered(stage, step)[0].frame_id for step in range(60)])
    assert len(set(arrived[0])) > 20
    assert all(each == arrived[0] for each in arrived)


@pytest.mark.parametrize("camera", SHIPPED)
def test_the_image_that_warms_a_camera_up_leaves_no_trace(
    tmp_path: Path, camera: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[str] = []
    for kind in (PerfectExposure, StereoExposure):
        monkeypatch.setattr(kind, "expose", _noting(kind.expose, seen))
    with CameraStage("lockstep", tmp_path, camera) as stage:
        cold, warm = build(stage.context), warmed_camera(stage.context)
        assert len(seen) == 1  # nobody's, before the first of the run
        for step in range(30):
            truth = level_truth(step, 0.01 * step, 0.3)
            one, other = (each.step(truth, truth.time_ns) for each in (cold, warm))
            assert (one is None) == (other is None)
            if one is not None and other is not None:
                assert (one.time_ns, one.frame_id) == (other.time_ns, other.frame_id)
                np.testing.assert_array_equal(one.depth, other.depth)
        assert cold.due is not None


def _noting(expose: Callable[..., Any], seen: list[str]) -> Callable[..., Any]:
    def noted(own: object, truth: GroundTruth) -> Any:
        seen.append(type(own).__name__)
        return expose(own, truth)

    return noted


@pytest.mark.parametrize("steps", [40])
def test_realtime_publishes_by_the_clock(tmp_path: Path, steps: int) -> None:
    with CameraStage("realtime", tmp_path) as stage:
        clock, ages = stage.context.clock, []
        begin_ns = clock.now_ns()
        for step in range(steps):
            time_ns = begin_ns + step * 10_000_000
            while (left_s := 1e-9 * (time_ns - clock.now_ns())) > 0.0:
                if (sample := stage.frames.wait(timeout_s=left_s)) is not None:
                    ages.append(1e-9 * (clock.now_ns() - sample.message.time_ns))
            stage.truths.put(level_truth(step, 0.01 * step, 0.3, time_ns))
        assert len(ages) >= 8  # of 20 exposures less the last four, on a machine that may be busy
        assert min(ages) >= 0.025
        assert np.median(ages) <= 0.075
