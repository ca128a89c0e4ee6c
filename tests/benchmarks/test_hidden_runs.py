"""Runs of the benchmark of hidden effects: what is planned, performed and logged."""

import copy
import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hidden_swing import swing

from benchmarks.hidden_effects import (
    cases,
    confusion,
    experiments,
    parameters,
    plan,
)
from benchmarks.hidden_effects.damage import DAMAGES, damage
from benchmarks.hidden_effects.followup import follow
from benchmarks.hidden_effects.generate import generate_run
from benchmarks.hidden_effects.joints import JointScene
from benchmarks.hidden_effects.legs import (
    Hidden,
    simulate,
)
from benchmarks.hidden_effects.robot import LOWER, TORQUE_LIMIT, UPPER
from benchmarks.hidden_effects.tables import RunFiles, joint_columns


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_changes_a_log(name):
    rng = np.random.default_rng(0)
    t = np.arange(2000) * 0.002
    measured, command = rng.normal(size=(2000, 12, 3)), swing(2000)
    files = RunFiles(
        meta={"kp": [30.0] * 12}, tables={"joints": joint_columns(t, measured, command)}
    )
    before = {column: values.copy() for column, values in files.tables["joints"].items()}
    assert damage(files, name, rng)
    after = files.tables["joints"]
    same = all(len(before[c]) == len(after[c]) and np.all(before[c] == after[c]) for c in before)
    assert not same or files.meta["kp"] != [30.0] * 12


@pytest.mark.parametrize("seed", range(3))
def test_a_plan_has_its_shares_and_every_effect(seed):
    runs = plan.make_plan(seed, 220)
    counts = Counter(run.category for run in runs)
    assert counts == {"none": 44, "one": 99, "two": 44, "outside": 22, "damaged": 11}
    everything = {name for names in plan.LIBRARY.values() for name in names}
    assert everything == set(parameters.MAIN)
    assert {effect for run in runs if run.category == "one" for effect in run.effects} == everything
    assert len({run.name for run in runs}) == len(runs)
    multiples = Counter(run.multiples[0] for run in runs if run.category == "one")
    assert set(multiples) == set(plan.MULTIPLES)
    assert runs == plan.make_plan(seed, 220)


@pytest.mark.parametrize("seed", range(3))
def test_pairs_and_play_are_joints_alone_that_are_large_enough(seed):
    runs = plan.make_plan(seed, 150, part="pairs_and_play")
    assert runs == plan.make_plan(seed, 150, part="pairs_and_play")
    counts = Counter(run.category for run in runs)
    assert (counts["none"], counts["play"]) == (41, 21)
    assert counts["one"] + counts["two"] == 88
    assert {(run.kind, run.quiet, run.damage) for run in runs} == {("joints", False, "")}
    assert min(m for run in runs for m in run.multiples) >= 3.0
    assert {run.sizes[0] for run in runs if run.category == "play"} == set(plan.WIDTHS)
    assert {run.effects for run in runs if run.category == "play"} == {("backlash",)}


@pytest.mark.parametrize("count", [1, 7, 24, 200])
def test_shares_sum_up(count):
    assert len(plan.make_plan(0, count)) == count


@pytest.mark.parametrize("kind", list(plan.KINDS))
def test_tuning_never_sees_the_outside_effects_of_the_sealed_set(kind):
    assert not set(plan.TUNING_OUTSIDE[kind]) & set(plan.SEALED_OUTSIDE[kind])
    for tuning, names in ((True, plan.TUNING_OUTSIDE), (False, plan.SEALED_OUTSIDE)):
        runs = [
            r
            for r in plan.make_plan(3, 300, tuning=tuning)
            if r.category == "outside" and r.kind == kind
        ]
        assert {effect for run in runs for effect in run.effects} <= set(names[kind])


@pytest.fixture(scope="module")
def performer():
    return JointScene(6, tuning=False, quiet=False, legs=(0,))


@pytest.mark.sample(2)
@pytest.mark.parametrize("name", list(experiments.JOINTS))
def test_experiments_of_joints_stay_within_the_robot(name, performer):
    scene = copy.deepcopy(performer)
    command, segments = experiments.joint_commands(
        name, scene.rig.control_dt, np.random.default_rng(0)
    )
    kp = scene.rig.kp
    scene.perform(command, segments, experiments.STIFFER.get(name, 1.0))
    assert np.all((scene.rig.command[..., 0] > LOWER) & (scene.rig.command[..., 0] < UPPER))
    assert np.allclose(scene.rig.kp, experiments.STIFFER.get(name, 1.0) * kp, rtol=1e-3)
    torque = np.abs(simulate(scene.rig, [Hidden()], legs=(0,))[0][:, :3, 2])
    assert np.all(torque.max(axis=0) < 1.2 * TORQUE_LIMIT[:3])
    assert segments[-1].end_s == pytest.approx(len(command) * scene.rig.control_dt)


@pytest.fixture(scope="module")
def run() -> plan.Run:
    return next(r for r in plan.make_plan(1, 60, ("joints",)) if r.effects == ("torque_gain",))


@pytest.fixture(scope="module")
def generated(run, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("first")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(JointScene, "library", ("torque_gain", "viscous_friction"))
        generate_run(run, folder / "logs", folder / "truth", tuning=True)
    return folder


def test_a_log_repeats_and_tells_nothing_but_what_was_measured(
    run, generated, tmp_path, monkeypatch
):
    monkeypatch.setattr(JointScene, "library", ("torque_gain", "viscous_friction"))
    generate_run(run, tmp_path / "logs", tmp_path / "truth", tuning=True)
    first, second = (place / "logs" / run.name for place in (generated, tmp_path))
    assert sorted(path.name for path in first.iterdir()) == ["joints.parquet", "meta.json"]
    for path in first.iterdir():
        assert path.read_bytes() == (second / path.name).read_bytes()
    said = (first / "meta.json").read_text()
    assert not [name for names in plan.LIBRARY.values() for name in names if name in said]
    truth = json.loads((tmp_path / "truth" / f"{run.name}.json").read_text())
    assert truth["multiples"][0] == pytest.approx(run.multiples[0])
    assert "viscous_friction" in truth["rivals"][0]


@pytest.mark.parametrize("part", ["all", "pairs_and_play"])
def test_every_run_of_a_plan_has_a_row_in_the_confusion_matrix(part):
    runs = plan.make_plan(5, 60, part=part)
    told = [
        {
            "category": run.category,
            "kind": run.kind,
            "quiet": False,
            "effects": [{"name": name} for name in run.effects],
            "multiples": [8.0 for _ in run.effects],
            "shown_rms": [8.0 for _ in run.effects],
            "rivals": [{} for _ in run.effects],
        }
        for run in runs
    ]
    said = [
        cases.Case(truth=truth, verdict={"verdict": "unexplained"}, baselines={}, seconds=None)
        for truth in told
    ]
    _, _, counts = confusion.matrix(said)
    assert counts.sum() == sum(run.category != "two" for run in runs)


def test_a_robot_that_follows_up_is_the_same_robot(run, generated, tmp_path):
    truth = json.loads((generated / "truth" / f"{run.name}.json").read_text())
    verdict = {
        "verdict": "set",
        "sets": [["torque_gain", "armature"]],
        "next_experiment": {"name": "slow_triangle"},
    }
    case = cases.Case(truth=truth, verdict=verdict, baselines={}, seconds=None)
    assert follow(case, tmp_path)
    first, second = (
        json.loads((p / run.name / "meta.json").read_text()) for p in (generated / "logs", tmp_path)
    )
    motions = [claims.pop("excitation")["segments"] for claims in (first, second)]
    assert first == second
    assert {segment["condition"] for segment in motions[1]} == {"slow", "faster"}
    verdict["next_experiment"] = {"name": "wall_two_ranges"}  # nothing to see for joints
    assert not follow(case, tmp_path / "none")
