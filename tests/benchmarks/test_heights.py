"""The benchmark of heights: what is counted, where it goes on,
and that its scenes are none of the training's.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import heights
from benchmarks._scenes import FINISH_X, SCENES, scene
from benchmarks.heights import Benchmark, desk_rows, table
from saltus.depth import MODEL_CAMERA, depth_frame
from saltus.grid import HEIGHTMAP_X
from saltus.heightmap.evaluation.distance_travelled import DistanceTravelled
from saltus.heightmap.evaluation.held_out import HARD, NETWORK, HeldOutPrediction, HeldOutRun
from saltus.heightmap.evaluation.visibility import UNSEEN
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.terrain.boxes import Box
from saltus.terrain.curriculum import SCENERY
from saltus.terrain.terrain import check_terrain
from saltus.wire.messages import DepthFrame, HeightmapStatus
from saltus.wire.topics import CAMERA_PERIOD_S

SHAPE = (200, 30)
SEEDS = range(20)


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("seed", SEEDS)
def test_robots_can_start_in_every_scene_and_see_something(name: str, seed: int) -> None:
    terrain = check_terrain(scene(name, np.random.default_rng(seed)), name)
    x, y = np.meshgrid(np.linspace(-0.5, FINISH_X, 200), np.linspace(-0.5, 0.5, 41))
    height = np.asarray(terrain.height_at(x.ravel(), y.ravel()))
    assert (height[x.ravel() < 0.4] == 0.0).all()
    assert height.max() > 0.05
    assert height.min() == 0.0


@pytest.mark.parametrize("name", SCENES)
def test_no_scene_is_drawn_by_the_law_of_training(name: str) -> None:
    def boxes(seed: int) -> set[Box]:
        return set(scene(name, np.random.default_rng(seed)).boxes)

    drawn = set[Box]().union(
        *(SCENERY["clutter"](0.5, np.random.default_rng(seed)).boxes for seed in SEEDS)
    )
    assert all(boxes(seed) - boxes(seed + 1) and not boxes(seed) & drawn for seed in SEEDS)


def run_of(rng: np.random.Generator, terrain: str) -> HeldOutRun:
    true, view = rng.normal(size=SHAPE), rng.integers(0, 3, SHAPE).astype(np.int8)
    said = HeldOutPrediction(
        height=true + rng.normal(size=SHAPE), half_width_90=rng.uniform(0.01, 0.9, SHAPE)
    )
    status = rng.choice((HeightmapStatus.OK, HeightmapStatus.DEGRADED), SHAPE[0]).astype(np.int8)
    return HeldOutRun(
        terrain=terrain,
        level=HARD,
        x=HEIGHTMAP_X,
        true_height=true,
        view=view,
        predictions={NETWORK: said},
        status=status,
        way=DistanceTravelled(distance_m=1.0, edges=0, of_edges=2),
    )


def test_figures_are_those_of_all_points_together(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    batches = [[run_of(rng, "stairs"), run_of(rng, "gap")], [run_of(rng, "stairs")]]
    monkeypatch.setattr(heights.SceneRuns, "measure", lambda _, __, batch: batches[batch[0]])
    counts = [
        heights.count(Path(), (heights.SceneRuns(robot="go1", grid="line"), (i, 2)))
        for i in range(len(batches))
    ]
    found = table(json.loads(json.dumps(counts)))
    for name, runs in {"all": [*batches[0], *batches[1]], "gap": batches[0][1:]}.items():
        said = [run.predictions[NETWORK] for run in runs]
        error = np.concatenate(
            [np.abs(s.height - run.true_height) for s, run in zip(said, runs, strict=True)]
        )
        width, view = (
            np.concatenate([s.half_width_90 for s in said]),
            np.concatenate([run.view for run in runs]),
        )
        ok = np.concatenate([run.status == HeightmapStatus.OK for run in runs])
        row, covered = found[name], error <= width
        assert row["steps"] == len(error)
        assert row["seen_mm"] == pytest.approx(1e3 * error[view != UNSEEN].mean(), abs=0.01)
        assert row["unseen_mm"] == pytest.approx(1e3 * error[view == UNSEEN].mean(), abs=0.01)
        assert row["covered_%"] == pytest.approx(100.0 * covered.mean(), abs=0.01)
        assert row["covered_unseen_%"] == pytest.approx(
            100.0 * covered[view == UNSEEN].mean(), abs=0.01
        )
        assert row["ok_%"] == pytest.approx(100.0 * ok.mean(), abs=0.01)
        assert row["ok_covered_%"] == pytest.approx(100.0 * covered[ok].mean(), abs=0.01)
        assert row["ok_median_half_width_mm"] == pytest.approx(1e3 * np.median(width[ok]), rel=0.03)


def test_it_goes_on_where_it_was_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    measured: list[tuple[int, int]] = []

    def count(_: Path, task: Any) -> dict[str, Any]:
        measured.append(task[1])
        counted = heights._counted(
            run_of(np.random.default_rng(task[1]), "flat"), np.ones(SHAPE[0], np.bool_)
        )
        return {"flat": {"ok": counted, "other": counted}}

    monkeypatch.setattr(heights, "count", count)
    out = tmp_path / "heights.jsonl"
    Benchmark(sets=("scenes",), runs=30, processes=1, out=out).measure()
    assert measured == [(0, 20), (1, 10)]
    lines = out.read_text().splitlines()
    out.write_text(lines[1] + "\n")
    again = Benchmark(sets=("scenes", "readme"), runs=30, processes=1, out=out).measure()
    assert measured[2:] == [(0, 20), (0, 20), (2, 10)]
    assert again == Benchmark(sets=("scenes", "readme"), runs=30, processes=1, out=out).measure()
    assert len(measured) == 5


def ground(below_m: float) -> list[DepthFrame]:
    """Images of level ground by a camera as the robot has it, so far below it [m]."""
    pitch = load_robot(DEFAULT_ROBOT).camera_pitch
    down = (np.arange(MODEL_CAMERA.height) + 0.5 - MODEL_CAMERA.cy) / MODEL_CAMERA.fy
    depth = below_m / np.maximum(np.sin(pitch) + down * np.cos(pitch), 1e-3)
    image = np.minimum(1e3 * depth, 6e4).astype(np.uint16)[:, None]
    return [depth_frame(MODEL_CAMERA, np.tile(image, MODEL_CAMERA.width), time_ns=0, frame_id=0)]


def test_drops_that_are_stated_are_counted() -> None:
    robot = load_robot(DEFAULT_ROBOT)
    level = robot.stand_height + float(robot.camera_position[2])
    assert desk_rows(heights.HEIGHTMAP, ground(level))["30 deg"]["drops"] == 0
    warm_s = HeightmapNetwork(robot, heights.HEIGHTMAP).warmup_frames * CAMERA_PERIOD_S
    for row in desk_rows(heights.HEIGHTMAP, ground(level + 0.4)).values():
        assert row["ok_%"] == pytest.approx(100.0 * (1.0 - warm_s / heights.DESK_S), abs=4.0)
        assert 0 < row["drops"] < row["points"]
        assert 0.0 < row["least_half_width_mm"] < 900.0
