"""The split of depth to heights: what its runs are made of, and what baselines make of its inputs."""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.depth_to_heights import split as splits
from benchmarks.depth_to_heights.files import (
    INPUTS,
    read_inputs,
    read_split,
    read_truth,
)
from benchmarks.depth_to_heights.predictors import BASELINES, predict
from benchmarks.depth_to_heights.split import (
    RUNS,
    definition,
    make_batch,
    plans,
    truth_digest,
)
from saltus.cli.main import main
from saltus.heightmap.data import closed_loop
from saltus.heightmap.evaluation import held_out
from saltus.heightmap.evaluation.held_out import HeldOutRuns
from saltus.heightmap.settings import ClosedLoop
from saltus.robots.loading import load_robot
from saltus.terrain.curriculum import FAMILIES
from saltus.used_networks import model_path

PROJECT = Path(__file__).resolve().parents[2]


SHORT_S = 1.6


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The split's first run, cut short."""
    path = tmp_path_factory.mktemp("short") / "split"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(splits, "TIME_LIMIT_S", SHORT_S)
        assert (
            main(
                [
                    "bench",
                    "depth_to_heights",
                    "make",
                    "--runs",
                    "1",
                    "--out",
                    str(path),
                    "--processes",
                    "1",
                ]
            )
            == 0
        )
    return path


class _BegunError(Exception):
    """Raised in place of a roll-out."""


def seeds_of(module: Any, begin: Callable[[], object], monkeypatch: pytest.MonkeyPatch) -> set[int]:
    """Those of the trials that a module would run."""
    seen: list[int] = []

    def rollout(setups: Any, *_: Any, **__: Any) -> None:
        seen.extend(setup.trial.seed for setup in setups)
        raise _BegunError

    monkeypatch.setattr(module, "Loop", rollout)
    with pytest.raises(_BegunError):
        begin()
    assert seen
    return set(seen)


def test_no_training_and_no_other_evaluation_draws_these_trials(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    own = {plan.seed for plan in plans()}
    assert len(own) == RUNS
    loop = ClosedLoop(robot="go1", grid="line", robots=4, courses=1)
    for key in (
        (0, 0, 0),
        (16000400, 0, 3),
        (splits.FIRST_SEED, 1, 0),
        (splits.FIRST_SEED, 0, 1),
        (2**53, 9, 9),
    ):
        begin = partial(closed_loop.closed_loop_episodes, loop, None, key)
        assert min(seeds_of(closed_loop, begin, monkeypatch)) > max(own)
    for seed in (0, 7, held_out.LAST_SEED):
        for batch in ((0, held_out.ROBOTS), (10**6 // held_out.ROBOTS, held_out.ROBOTS)):
            begin = partial(
                HeldOutRuns(robot="go1", grid="line", runs=10**6, seed=seed).measure,
                model_path("heightmap"),
                batch,
            )
            assert max(seeds_of(held_out, begin, monkeypatch)) < min(own)


def test_no_list_of_numbers_draws_these_courses() -> None:
    """Trainings and evaluations draw from lists of up to three: seed, round, number."""
    first = splits.FIRST_SEED
    of_batch = (
        np.random.SeedSequence(first, spawn_key=(splits.VERSION, 0)).generate_state(4).tolist()
    )
    lists = (
        [first],
        [first, splits.VERSION],
        [first, splits.VERSION, 0],
        [first, 0, 0],
        [first, 0, splits.VERSION],
    )
    assert all(
        np.random.SeedSequence(numbers).generate_state(4).tolist() != of_batch for numbers in lists
    )


def test_the_split_is_the_one_that_the_table_is_of() -> None:
    """Whoever changes what it follows from makes another version, with a table of its own."""
    page = (PROJECT / "docs" / "benchmark.md").read_text()
    assert f"definition `{definition(plans())}`" in page
    assert f"version {splits.VERSION}," in page
    assert {plan.terrain.terrain for plan in plans()} == set(FAMILIES)
    assert plans(30) == plans()[:30]


def test_a_run_is_made_of_its_plan_alone(short: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(splits, "TIME_LIMIT_S", SHORT_S)
    (again,) = make_batch(plans(1))
    split = read_split(short)
    (truth,) = read_truth(split)
    assert truth_digest([again.truth]) == split.truth
    inputs = read_inputs(split, 0)
    np.testing.assert_array_equal(inputs.depth, again.inputs.depth)
    assert abs(len(truth.height) - 100 * SHORT_S) < 3
    shown = inputs.depth_age_s >= 0.0
    assert not inputs.depth[~shown].any()
    assert 0 < np.argmax(shown) < 20
    assert (inputs.depth_age_s[shown] >= 0.03 - 1e-6).all()  # no image comes sooner
    assert inputs.depth_age_s.max() < 0.2
    # flat ground: what the robot says of its height is near the truth
    assert np.abs(truth.height + inputs.robot["base_height"][:, None]).max() < 0.03


def test_all_baselines_predict_from_the_inputs(short: Path, capsys: Any) -> None:
    assert (
        main(
            [
                "bench",
                "depth_to_heights",
                "score",
                "--split",
                str(short),
                "--processes",
                "1",
                "--json",
            ]
        )
        == 0
    )
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert list(found["rows"]) == [*BASELINES, "network"]
    # Of a robot on flat ground
    assert all(figures["mae_m"] < 0.03 for figures in found["rows"].values())
    assert set(found["models"]) == {"network"}


@pytest.mark.parametrize(("name", "forgets"), [("newest", True), ("geometric", False)])
def test_the_newest_image_is_all_that_its_baseline_knows(
    name: str, forgets: bool, short: Path
) -> None:
    inputs, robot = read_inputs(read_split(short), 0), load_robot("go1")
    new = (
        np.flatnonzero(
            np.diff(np.arange(len(inputs.depth)) - np.rint(100 * inputs.depth_age_s)) != 0
        )
        + 1
    )
    begin = int(new[len(new) // 2])
    age = inputs.depth_age_s.copy()
    age[:begin] = -1.0
    late = predict(BASELINES[name](robot), replace(inputs, depth_age_s=age)).height[begin:]
    whole = predict(BASELINES[name](robot), inputs).height[begin:]
    assert np.array_equal(late, whole) is forgets


def test_the_example_scores_as_flat_ground(short: Path, tmp_path: Path, capsys: Any) -> None:
    out = tmp_path / "mine.parquet"
    example = PROJECT / "examples" / "own_predictor.py"
    subprocess.run([sys.executable, "-I", example, short / INPUTS, out], check=True, timeout=60)
    words = [
        "bench",
        "depth_to_heights",
        "score",
        str(out),
        "--baselines",
        "flat",
        "--split",
        str(short),
        "--json",
    ]
    assert main([*words, "--processes", "1"]) == 0
    rows = json.loads(capsys.readouterr().out.splitlines()[-1])["rows"]
    assert rows[str(out)]["mae_m"] == pytest.approx(rows["flat"]["mae_m"], abs=1e-6)


def test_it_needs_no_package_that_only_training_needs() -> None:
    blocked = (
        "import sys; sys.modules.update(dict.fromkeys(('h5py', 'torch', 'kornia', 'warp', "
        "'mujoco_warp')));"
    )
    modules = ("benchmarks.depth_to_heights.command", "saltus.heightmap.evaluation.held_out")
    imports = "".join(f"import {module};" for module in modules)
    subprocess.run([sys.executable, "-c", blocked + imports], check=True, timeout=60)
