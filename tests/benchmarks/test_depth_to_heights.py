"""The benchmark of depth to heights: what is scored,
what predictors are given, and what is refused.
"""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from benchmarks.depth_to_heights.files import (
    HALF_WIDTH,
    HEIGHT,
    INPUTS,
    RUN,
    SPLIT,
    STEP,
    TRUTH,
    read_inputs,
    read_split,
    read_truth,
    write_predictions,
    write_split,
)
from benchmarks.depth_to_heights.rows import ScoreRow, row
from benchmarks.depth_to_heights.split import (
    OBSERVED,
    RUNS,
    Inputs,
    SplitRun,
    Truth,
    plans,
    truth_digest,
)
from saltus.cli.main import main
from saltus.heightmap.evaluation.held_out import HeldOutPrediction
from saltus.heightmap.evaluation.visibility import VIEWS
from saltus.heightmap.service.proprioception_vector import PROPRIOCEPTION
from saltus.loop.loop import STAND_STEPS

LENGTHS = (130, 160, 145)


TERRAINS = ("flat", "stairs", "stairs")


WIDE = {
    "joint_position": 12,
    "joint_velocity": 12,
    "quaternion_base_in_world": 4,
    "leg_contact": 4,
    "leg_trusted": 4,
}


def synthetic_run(steps: int, terrain: str, seed: int) -> SplitRun:
    rng = np.random.default_rng(seed)
    robot: dict[str, Any] = {
        name: rng.normal(size=(steps, WIDE.get(name, 3))).astype(np.float32) for name in OBSERVED
    }
    robot |= {name: robot[name] > 0.0 for name in ("leg_contact", "leg_trusted")}
    robot["base_height"] = robot["base_height"][:, 0]
    inputs = Inputs(
        proprioception=rng.normal(size=(steps, len(PROPRIOCEPTION))).astype(np.float32),
        depth=rng.integers(0, 65536, (steps, 48, 16)).astype(np.uint16),
        depth_age_s=rng.uniform(0.0, 0.1, steps).astype(np.float32),
        robot=robot,
    )
    edge = rng.integers(5, 25, (steps, 1))  # a step of 0.1 m after this many points
    height = (rng.normal(-0.3, 0.05, (steps, 1)) + 0.1 * (np.arange(30) >= edge)).astype(np.float32)
    view = np.repeat(rng.integers(0, len(VIEWS), (steps, 1)), 30, axis=1).astype(np.int8)
    return SplitRun(inputs=inputs, truth=Truth(terrain=terrain, height=height, view=view))


SYNTHETIC = [
    synthetic_run(*known, seed) for seed, known in enumerate(zip(LENGTHS, TERRAINS, strict=True))
]


TRUTHS = [run.truth for run in SYNTHETIC]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A split of runs that nobody ran."""
    path = tmp_path_factory.mktemp("split") / "synthetic"
    write_split(path, plans(len(SYNTHETIC)), [SYNTHETIC[:2], SYNTHETIC[2:]])
    return path


def said(shift_m: float = 0.0, half_width_m: float = 0.001) -> list[HeldOutPrediction]:
    """The truth, and so much more."""
    heights = [truth.height + shift_m for truth in TRUTHS]
    return [
        HeldOutPrediction(height=height, half_width_90=np.full_like(height, half_width_m))
        for height in heights
    ]


def scored(predictions: list[HeldOutPrediction]) -> ScoreRow:
    return row("mine", TRUTHS, predictions)


def test_who_knows_the_truth_scores_no_error_and_the_greatest_likelihood() -> None:
    best = scored(said())
    for figures in (best.figures, *best.by_terrain.values()):
        assert figures["mae_m"] == figures["mae_unseen_m"] == figures["edge_error_m"] == 0.0
        assert figures["coverage90"] == figures["edges_found"] == 1.0
    others = (
        said(0.001),
        said(-0.001),
        said(half_width_m=0.002),
        said(half_width_m=0.5),
        said(0.02, 0.02),
    )
    assert all(best.figures["nll"] < scored(other).figures["nll"] for other in others)
    # who states less than can be told apart gains nothing
    assert scored(said(half_width_m=1e-9)).figures == best.figures


@pytest.mark.parametrize("shift_mm", [-300.0, -7.0, 0.5, 42.0])
def test_a_shift_scores_what_it_is(shift_mm: float) -> None:
    found = scored(said(1e-3 * shift_mm, half_width_m=0.01))
    for figures in (found.figures, *found.by_terrain.values()):
        for name in ("mae_m", *(f"mae_{view}_m" for view in VIEWS)):
            assert 1e3 * figures[name] == pytest.approx(abs(shift_mm), abs=1e-3)
        assert figures["coverage90"] == float(abs(shift_mm) < 10.0)
        assert figures["edge_error_m"] == pytest.approx(0.0, abs=1e-6)
    assert found.interval90["mae_m"] == pytest.approx((1e-3 * abs(shift_mm),) * 2, abs=1e-6)


def test_standing_does_not_count_and_terrains_are_their_own_runs() -> None:
    predictions = said()
    for prediction, shift in zip(predictions, (0.0, 0.03, 0.03), strict=True):
        prediction.height[:STAND_STEPS] += 9.0
        prediction.height[STAND_STEPS:] += shift
    found = scored(predictions)
    assert found.by_terrain["flat"]["mae_m"] == 0.0
    assert found.by_terrain["stairs"]["mae_m"] == pytest.approx(0.03, abs=1e-6)
    assert 0.0 < found.figures["mae_m"] < 0.03


def test_intervals_hold_the_mean_of_runs_as_often_as_they_say() -> None:
    """Of runs that each err by another amount, all alike in kind and length."""
    rng, steps, runs = np.random.default_rng(3), STAND_STEPS + 4, 30
    truths = [
        Truth(
            terrain="flat",
            height=np.zeros((steps, 30), np.float32),
            view=np.zeros((steps, 30), np.int8),
        )
    ] * runs
    held = []
    for _ in range(40):
        errors = rng.exponential(0.01, runs)
        wide = np.full((steps, 30), 0.02)
        found = row(
            "mine",
            truths,
            [HeldOutPrediction(height=np.full((steps, 30), e), half_width_90=wide) for e in errors],
        )
        low, high = found.interval90["mae_m"]
        assert low < found.figures["mae_m"] < high
        held.append(low <= 0.01 <= high)
    assert 0.7 <= np.mean(held) <= 0.99


def test_a_file_scores_what_its_rows_say_in_any_order(
    folder: Path, tmp_path: Path, capsys: Any
) -> None:
    predictions = said(0.005, 0.02)
    write_predictions(tmp_path / "mine.parquet", predictions)
    table = pq.read_table(tmp_path / "mine.parquet")
    order = np.random.default_rng(0).permutation(table.num_rows)
    pq.write_table(table.take(order), tmp_path / "mixed.parquet")
    files = [str(tmp_path / name) for name in ("mine.parquet", "mixed.parquet")]
    assert (
        main(["bench", "depth_to_heights", "score", *files, "--split", str(folder), "--json"]) == 0
    )
    found = json.loads(capsys.readouterr().out)
    assert main(["bench", "depth_to_heights", "score", *files, "--split", str(folder)]) == 0
    out = capsys.readouterr().out
    assert f"{len(LENGTHS)} runs of {RUNS}: no rows of the table" in out
    assert f"{files[0]}  5.00 +-0.00" in re.sub(r" {2,}", "  ", out)
    assert found["split"]["whole"] is False
    assert found["split"]["truth"] == truth_digest(TRUTHS)
    mine, mixed = (found["rows"][name] for name in files)
    assert mine == mixed
    assert mine["mae_m"] == pytest.approx(0.005, abs=1e-6)
    assert set(mine["by_terrain"]) == {"flat", "stairs"}


def column(name: str, change: Callable[[np.ndarray], Any]) -> Callable[[pa.Table], pa.Table]:
    """Changes the values of one column, rows first."""

    def changed(table: pa.Table) -> pa.Table:
        values = np.array(table[name].to_pylist(), np.float64)
        made = change(values)
        values = values if made is None else made
        kind = pa.int64() if values.ndim == 1 else pa.list_(pa.float64())
        return table.set_column(
            table.schema.get_field_index(name), name, pa.array(values.tolist(), kind)
        )

    return changed


def put(value: float) -> Callable[[np.ndarray], None]:
    def change(values: np.ndarray) -> None:
        values[LENGTHS[0] + 5, 7] = value

    return change


WHERE = f"{RUN} 1, {STEP} 5: "


DAMAGES: dict[str, tuple[Callable[[pa.Table], pa.Table], str]] = {
    "missing": (
        lambda table: pa.concat_tables([table[:140], table[141:]]),
        f"{RUN} 1 and {STEP} 10 is missing",
    ),
    "last": (lambda table: table[:-1], f"{RUN} 2 and {STEP} {LENGTHS[2] - 1} is missing"),
    "twice": (
        lambda table: pa.concat_tables([table, table[3:4]]),
        f"{RUN} 0 and {STEP} 3 stands twice",
    ),
    "instead": (
        lambda table: pa.concat_tables([table[1:], table[3:4]]),
        f"{RUN} 0 and {STEP} 3 stands twice",
    ),
    "run": (column(RUN, lambda values: values + 1), f"no row with {RUN} 2 and {STEP} {LENGTHS[2]}"),
    "step": (column(STEP, lambda values: values - 1), f"no row with {RUN} 0 and {STEP} -1"),
    "nan": (
        column(HEIGHT, put(np.nan)),
        f"{WHERE}'height' of point 7 is nan; it must be from -10 to 10 m",
    ),
    "infinite": (column(HALF_WIDTH, put(np.inf)), f"{WHERE}'half_width_90' of point 7 is inf"),
    "millimetres": (column(HEIGHT, lambda values: 1e3 * values), "it must be from -10 to 10 m"),
    "narrow": (
        column(HALF_WIDTH, put(0.0)),
        f"{WHERE}'half_width_90' of point 7 is 0; it must be above 0",
    ),
    "negative": (column(HALF_WIDTH, put(-0.1)), "is -0.1; it must be above 0"),
    "points": (
        column(HEIGHT, lambda values: values[:, 1:]),
        "a list of 'height' has 29 numbers; it must have 30",
    ),
    "column": (lambda table: table.drop_columns([HALF_WIDTH]), "column 'half_width_90' is missing"),
    "kind": (
        lambda table: table.set_column(0, RUN, pa.array(["one"] * table.num_rows)),
        f"column '{RUN}' is string; it must be int64",
    ),
    "null": (
        lambda table: table.set_column(0, RUN, pa.array([None] * table.num_rows, pa.int64())),
        f"column '{RUN}' has {sum(LENGTHS)} rows without a value",
    ),
    "empty": (lambda table: table[:0], f"{RUN} 0 and {STEP} 0 is missing"),
    "long": (
        lambda table: pa.concat_tables([table] * 3),
        f"{3 * sum(LENGTHS)} rows, the split has {sum(LENGTHS)}",
    ),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_what_cannot_be_scored_is_refused_by_one_line(
    name: str, folder: Path, tmp_path: Path, capsys: Any
) -> None:
    path = tmp_path / "mine.parquet"
    write_predictions(path, said())
    damage, told = DAMAGES[name]
    pq.write_table(damage(pq.read_table(path)), path)
    assert main(["bench", "depth_to_heights", "score", str(path), "--split", str(folder)]) == 2
    printed = capsys.readouterr()
    assert re.fullmatch(
        f"saltus: [^\n]*{re.escape(str(path))}[^\n]*{re.escape(told)}[^\n]*\n", printed.err
    ), printed.err
    assert not printed.out


@pytest.mark.parametrize(
    "content", [b"", b"PAR1", b"PAR1" + bytes(200) + b"PAR1", b"episode_index,frame_index\n0,0\n"]
)
def test_no_parquet_is_refused_by_one_line(
    content: bytes, folder: Path, tmp_path: Path, capsys: Any
) -> None:
    path = tmp_path / "mine.parquet"
    path.write_bytes(content)
    assert main(["bench", "depth_to_heights", "score", str(path), "--split", str(folder)]) == 2
    assert re.fullmatch(
        r"saltus: cannot read [^\n]*mine.parquet: [^\n]*\n", capsys.readouterr().err
    )


@pytest.mark.parametrize("name", [INPUTS, TRUTH, SPLIT])
def test_a_split_that_was_changed_is_refused(
    name: str, folder: Path, tmp_path: Path, capsys: Any
) -> None:
    copy = tmp_path / "copy"
    copy.mkdir()
    for path in folder.iterdir():
        (copy / path.name).write_bytes(path.read_bytes())
    if name == TRUTH:  # by as much as the digest tells apart
        lower = [replace(truth, height=truth.height - np.float32(0.001)) for truth in TRUTHS]
        others = [replace(run, truth=truth) for run, truth in zip(SYNTHETIC, lower, strict=True)]
        write_split(tmp_path / "other", plans(len(others)), [others])
        (copy / name).write_bytes((tmp_path / "other" / name).read_bytes())
    else:
        (copy / name).write_bytes((copy / name).read_bytes()[:-3])
    assert main(["bench", "depth_to_heights", "score", "--split", str(copy)]) == 2
    assert re.fullmatch(r"saltus: [^\n]*make[^\n]*\n", capsys.readouterr().err)


def test_inputs_say_nothing_of_the_truth(folder: Path, tmp_path: Path) -> None:
    """Another truth of the same images makes the same file,
    and no column of it is a height of the grid.
    """
    others = [
        replace(
            run, truth=Truth(terrain="gap", height=2.0 * run.truth.height, view=1 - run.truth.view)
        )
        for run in SYNTHETIC
    ]
    write_split(tmp_path / "other", plans(len(others)), [others])
    assert (tmp_path / "other" / INPUTS).read_bytes() == (folder / INPUTS).read_bytes()
    assert (tmp_path / "other" / TRUTH).read_bytes() != (folder / TRUTH).read_bytes()
    names = pq.read_schema(folder / INPUTS).names
    assert set(names) == {RUN, STEP} | {
        f"observation.{name}" for name in (*OBSERVED, "state", "depth", "depth_age")
    }


def test_what_is_read_is_what_was_written(folder: Path) -> None:
    split = read_split(folder)
    assert (split.runs, split.table["whole"]) == (len(SYNTHETIC), False)
    for number, (run, truth) in enumerate(zip(SYNTHETIC, read_truth(split), strict=True)):
        assert truth.terrain == run.truth.terrain
        np.testing.assert_array_equal(truth.height, run.truth.height)
        np.testing.assert_array_equal(truth.view, run.truth.view)
        inputs = read_inputs(split, number)
        for name in ("proprioception", "depth", "depth_age_s"):
            np.testing.assert_array_equal(getattr(inputs, name), getattr(run.inputs, name))
        for name in OBSERVED:
            np.testing.assert_array_equal(inputs.robot[name], run.inputs.robot[name])
