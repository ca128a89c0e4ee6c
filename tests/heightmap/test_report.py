import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recorded_run import Glide, glide, record
from report_pages import opens_without_a_network
from samples import ROBOT

from saltus import rotations
from saltus.cli.heightmap_measures import ReportHeightmap
from saltus.config import TerrainConfig
from saltus.depth import MODEL_CAMERA, RANGE_M
from saltus.errors import RecordingError
from saltus.grid import HEIGHTMAP_X, LINE
from saltus.heightmap.evaluation.comparison import (
    RECORDED,
    HeightComparison,
    compare_heights,
    in_view,
    read_compared_run,
)
from saltus.heightmap.evaluation.errors_by import REMEMBERED, VISIBLE, ErrorRow, GroupedErrors
from saltus.heightmap.evaluation.geometric import GeometricHeightmap
from saltus.heightmap.evaluation.height_edges import JUMP_M, edge_errors, jumps
from saltus.heightmap.evaluation.report import (
    APART_S,
    WORST,
    WORST_M,
    measure_errors,
    write_error_report,
)
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.replay import replay_frames, replay_predictor
from saltus.recordings.recording import Recording
from saltus.render.camera import camera_pose, ray_directions
from saltus.robots.mount import Mount
from saltus.wire.messages import ControllerMode, Heightmap, HeightmapStatus

CELL = float(HEIGHTMAP_X[1] - HEIGHTMAP_X[0])
TABLES: list[Callable[[GroupedErrors], list[ErrorRow]]] = [
    GroupedErrors.by_distance, GroupedErrors.by_terrain, GroupedErrors.by_view,
    GroupedErrors.by_phase, GroupedErrors.by_speed, GroupedErrors.by_age,
]  # fmt: skip


@pytest.fixture(scope="module")
def run() -> Glide:
    return glide(TerrainConfig(terrain="stairs", rise_m=0.08, run_m=0.3, steps=6))


@pytest.fixture(scope="module")
def geometric(run: Glide) -> list[Heightmap]:
    return replay_predictor(GeometricHeightmap(ROBOT, LINE), run.frames, run.states, run.arrival_ns)


@pytest.fixture(scope="module")
def recording(
    run: Glide, geometric: list[Heightmap], tmp_path_factory: pytest.TempPathFactory
) -> Recording:
    return record(tmp_path_factory.mktemp("run") / "recording.mcap", run, geometric)


def told(
    run: Glide, maps: list[Heightmap], error: np.ndarray, half_width: np.ndarray
) -> list[Heightmap]:
    """Heightmaps that are wrong by what is given, shapes (steps, 30)."""
    return [
        replace(heightmap, height=truth + e, half_width_90=w)
        for heightmap, truth, e, w in zip(maps, run.true_height, error, half_width, strict=True)
    ]


def compared(
    path: Path, run: Glide, maps: list[Heightmap], *, truth: bool = True
) -> HeightComparison:
    (comparison,) = compare_heights(read_compared_run(record(path, run, maps, truth=truth)))
    return comparison


def test_the_truth_has_no_error(run: Glide, geometric: list[Heightmap], tmp_path: Path) -> None:
    zero = np.zeros_like(run.true_height)
    maps = told(run, geometric, zero, zero + 0.01)
    report = measure_errors([record(tmp_path / "true.mcap", run, maps)])
    numbers = report.numbers()["predictors"][RECORDED]
    assert numbers["mae_m"] == pytest.approx(0.0, abs=1e-6)
    assert numbers["edge_error_m"] == pytest.approx(0.0, abs=1e-6)
    assert (numbers["edges_found"], numbers["edges_false"], numbers["coverage90"]) == (1.0, 0, 1.0)


@pytest.mark.parametrize("bias", [-0.02, 0.013])
def test_a_constant_error_is_found_in_every_group(
    run: Glide, geometric: list[Heightmap], tmp_path: Path, bias: float
) -> None:
    wrong = np.full_like(run.true_height, bias)
    errors = GroupedErrors(
        [compared(tmp_path / "bias.mcap", run, told(run, geometric, wrong, np.abs(wrong)))]
    )
    for table in TABLES:
        for row in table(errors):
            np.testing.assert_allclose(
                [row.mae_m, row.p90_m, abs(row.bias_m), row.half_width_90_m], abs(bias), atol=1e-6
            )
            assert np.sign(row.bias_m) == np.sign(bias)


def test_groups_share_out_all_points(recording: Recording) -> None:
    errors = GroupedErrors(compare_heights(read_compared_run(recording), ["geometric-feet"])[:1])
    overall = errors.overall()
    assert overall is not None
    for table in TABLES:
        rows = table(errors)
        assert sum(row.count for row in rows) == overall.count
        assert sum(row.count * row.mae_m for row in rows) / overall.count == pytest.approx(
            overall.mae_m
        )
    assert [row.group for row in errors.by_view()] == [VISIBLE, REMEMBERED]
    assert len(errors.by_distance()) == len(HEIGHTMAP_X)


@pytest.mark.parametrize("scale", [1.0, 0.5, 2.0])
def test_calibration_compares_what_is_stated_with_what_is(
    run: Glide, geometric: list[Heightmap], tmp_path: Path, scale: float
) -> None:
    rng = np.random.default_rng(3)
    half_width = rng.uniform(0.01, 0.08, run.true_height.shape)
    wrong = rng.laplace(size=half_width.shape) * half_width / np.log(10.0)
    maps = told(run, geometric, wrong, scale * half_width)
    calibration = GroupedErrors([compared(tmp_path / "c.mcap", run, maps)]).calibration()
    np.testing.assert_allclose(calibration.observed_m * scale, calibration.stated_m, rtol=0.15)
    if scale == 1.0:
        np.testing.assert_allclose(calibration.coverage, calibration.level, atol=0.03)
    else:
        assert (calibration.coverage90 > 0.9) == (scale > 1.0)


def test_the_true_spread_has_the_best_likelihood(
    run: Glide, geometric: list[Heightmap], tmp_path: Path
) -> None:
    wrong = np.random.default_rng(4).laplace(size=run.true_height.shape) * 0.02 / np.log(10.0)
    scores = [
        GroupedErrors(
            [
                compared(
                    tmp_path / f"{s}.mcap", run, told(run, geometric, wrong, np.full_like(wrong, s))
                )
            ]
        )
        .calibration()
        .nll
        for s in (0.01, 0.02, 0.04)
    ]
    assert scores[1] < min(scores[0], scores[2])


@pytest.mark.parametrize("size", [-0.4, -0.05, 0.05, 0.2])
@pytest.mark.parametrize("shift", [-3, -1, 0, 2])
def test_the_position_of_an_edge_is_measured(size: float, shift: int) -> None:
    edge = np.arange(8, 22)
    points = np.arange(len(HEIGHTMAP_X))
    true = size * (points >= edge[:, None])
    result = edge_errors(size * (points >= edge[:, None] + shift), true, HEIGHTMAP_X)
    np.testing.assert_allclose(result.error, shift * CELL, atol=1e-9)
    np.testing.assert_allclose(result.true_x, HEIGHTMAP_X[edge] - 0.5 * CELL, atol=1e-9)
    assert (result.found, result.false) == (1.0, 0)
    # The other way round it is another edge
    assert edge_errors(-true, true, HEIGHTMAP_X).found == 0.0
    assert edge_errors(true, 0.0 * true, HEIGHTMAP_X).false == len(edge)


def test_small_steps_and_slopes_of_noise_are_no_edges() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        profile = rng.uniform(-0.5, 0.5) + rng.uniform(-0.45, 0.45, len(HEIGHTMAP_X)) * JUMP_M
        assert jumps(profile, HEIGHTMAP_X) == []


def test_a_smooth_rise_has_its_edge_in_the_middle() -> None:
    for centre in np.linspace(0.0, 0.4, 7):
        profile = 0.2 / (1.0 + np.exp(-(HEIGHTMAP_X - centre) / 0.03))
        (jump,) = jumps(profile, HEIGHTMAP_X)
        assert jump.x == pytest.approx(centre, abs=0.01)


def test_in_view_is_what_pixels_look_at() -> None:
    rng = np.random.default_rng(1)
    rays = ray_directions(MODEL_CAMERA)
    for _ in range(20):
        quaternion = rotations.quaternion_from_roll_pitch_yaw(
            *(np.asarray(a) for a in rng.uniform(-0.5, 0.5, 3))
        )
        position = rng.normal(size=3)
        origin, rotation = camera_pose(Mount.of(ROBOT), position, quaternion)
        inside = rays * rng.uniform(0.1, 0.99 * RANGE_M, (48, 16, 1))
        beside = inside * [1.0, 1.0, 0.0] * 3.0 + inside * [0.0, 0.0, 1.0] + [0.0, 10.0, 0.0]
        for points, expected in (
            (inside, True),
            (-inside, False),
            (beside, False),
            (rays * 1.01 * RANGE_M, False),
        ):
            place = (points @ np.asarray(rotation).T + origin).reshape(-1, 3)
            assert (in_view(Mount.of(ROBOT), place, position, quaternion) == expected).all()


def test_a_replayed_model_is_the_recorded_one(run: Glide, model_path: Path, tmp_path: Path) -> None:
    maps = replay_frames(
        HeightmapNetwork(ROBOT, model_path), run.frames, run.states, run.arrival_ns
    )
    recorded, replayed = compare_heights(
        read_compared_run(record(tmp_path / "m.mcap", run, maps)), [str(model_path)]
    )
    np.testing.assert_array_equal(recorded.height, replayed.height)
    np.testing.assert_array_equal(recorded.visible, replayed.visible)


def test_only_trusted_steps_of_a_running_robot_count(
    run: Glide, geometric: list[Heightmap], tmp_path: Path
) -> None:
    standing = [
        replace(state, mode=ControllerMode.STAND) for state in run.states[:100]
    ] + run.states[100:]
    maps = [replace(h, status=HeightmapStatus.DEGRADED) if h.step % 2 else h for h in geometric]
    comparison = compared(tmp_path / "s.mcap", replace(run, states=standing), maps)
    np.testing.assert_array_equal(comparison.step, np.arange(100, len(run.states), 2))
    with pytest.raises(RecordingError, match="status OK"):
        compared(
            tmp_path / "none.mcap", run, [replace(h, status=HeightmapStatus.INVALID) for h in maps]
        )


def test_without_truth_predictions_are_measured_by_later_ones(
    run: Glide, geometric: list[Heightmap], tmp_path: Path
) -> None:
    zero = np.zeros_like(run.true_height)
    exact = compared(tmp_path / "a.mcap", run, told(run, geometric, zero, zero + 0.01), truth=False)
    assert exact.reference == "seen later"
    known = np.isfinite(exact.true_height)
    assert known[:100, HEIGHTMAP_X > 0.7].mean() > 0.9  # what has just come into view stays in view
    assert not known[:, HEIGHTMAP_X < 0.3].any()
    # Near an edge, a grid knows no better
    assert np.quantile(np.abs(exact.error[known]), 0.8) < 0.002
    wrong = zero + np.where(HEIGHTMAP_X > 0.7, 0.03, 0.0)
    far = compared(tmp_path / "b.mcap", run, told(run, geometric, wrong, zero + 0.01), truth=False)
    new = far.error[:100, HEIGHTMAP_X > 0.75]
    assert np.nanmedian(new) == pytest.approx(0.03, abs=0.01)


@pytest.mark.sample(1)
@pytest.mark.parametrize("kept", [0.3, 0.6, 0.95])
def test_a_cut_recording_is_measured_and_says_what_is_lost(
    recording: Recording, tmp_path: Path, kept: float
) -> None:
    data = recording.path.read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(data[: int(kept * len(data))])
    out = tmp_path / "report"
    assert (
        ReportHeightmap(recordings=(path, recording.path), model=("geometric",), out=out).run() == 0
    )
    text = (out / "report.html").read_text()
    assert "Lost in cut" in text
    assert "Lost in run" not in text


def test_what_lies_between_is_missed(
    run: Glide, geometric: list[Heightmap], tmp_path: Path
) -> None:
    holed = [i for i in range(len(run.states)) if not 120 <= i < 140]
    part = replace(
        run, states=[run.states[i] for i in holed], truths=[run.truths[i] for i in holed]
    )
    lost = read_compared_run(
        record(tmp_path / "hole.mcap", part, [geometric[i] for i in holed])
    ).lost
    assert f"20 of {len(run.states)} robot states" in lost
    assert any("depth images" in line for line in lost)


def test_nothing_to_compare_is_an_error(run: Glide, tmp_path: Path) -> None:
    empty = record(tmp_path / "empty.mcap", replace(run, states=[], truths=[]), [])
    with pytest.raises(RecordingError):
        measure_errors([empty])


def test_worst_moments_are_apart_and_worst_first(
    run: Glide, geometric: list[Heightmap], tmp_path: Path
) -> None:
    size = np.abs(np.random.default_rng(0).normal(0.0, 0.03, (len(run.states), 1)))
    maps = told(run, geometric, size * np.ones(30), size * np.ones(30) + 0.01)
    recording = record(tmp_path / "wrong.mcap", run, maps)
    worst = measure_errors([recording, recording]).worst()
    assert 1 < len(worst) <= WORST
    found = [float(np.nanmean(np.abs(c.error[i]))) for c, i in worst]
    assert found == sorted(found, reverse=True)
    assert found[-1] > WORST_M
    for n, (c, i) in enumerate(worst):
        assert all(d is not c or abs(d.time_s[j] - c.time_s[i]) > APART_S for d, j in worst[:n])


def test_good_moments_are_not_shown_as_worst(
    run: Glide, geometric: list[Heightmap], tmp_path: Path
) -> None:
    """Nor is what nobody knows printed as a number:
    ground without edges has none that were found.
    """
    wrong = np.full_like(run.true_height, 0.9 * WORST_M)
    flat = [replace(truth, height=np.full(30, -0.3)) for truth in run.truths]
    maps = [
        replace(h, height=np.full(30, -0.3) + e, half_width_90=np.full(30, 0.01))
        for h, e in zip(geometric, wrong, strict=True)
    ]
    recording = record(tmp_path / "flat.mcap", replace(run, truths=flat), maps)
    assert measure_errors([recording]).worst() == []
    write_error_report(measure_errors([recording]), tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text()
    assert "There are none." in text
    page = re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)
    assert not re.search(r"\bnan\b", page)


def test_the_page_has_every_part_and_numbers_are_json(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "report"
    names = ("geometric", "geometric-feet")
    assert (
        ReportHeightmap(
            recordings=(recording.path, recording.path), model=names, out=out, json=True
        ).run()
        == 0
    )
    numbers = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert list(numbers["predictors"]) == [RECORDED, *names]
    assert [row["name"] for row in numbers["runs"]] == [
        f"{recording.path.parent.name} ({n})" for n in (1, 2)
    ]
    # The recorded heights are the geometric ones: the two must agree in every number.
    assert numbers["predictors"][RECORDED] == numbers["predictors"]["geometric"]
    text = (out / "report.html").read_text()
    for title in (
        "distance",
        "gait phase",
        "speed",
        "age",
        "terrain",
        "remembered",
        "Edges",
        "intervals",
        "worst",
    ):
        assert title in text
    opens_without_a_network(out / "report.html")


def test_a_page_that_cannot_be_written_is_told(recording: Recording, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="name another"):
        write_error_report(measure_errors([recording]), tmp_path / "no" / "report.html")
