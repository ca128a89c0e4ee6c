"""The cycle: a hidden effect is found and trained with,
nothing is done twice, a training may be carried away.
"""

import html
import json
import shlex
import shutil
import subprocess
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from report_pages import opens_without_a_network
from samples import ROBOT

from saltus import gpu
from saltus.cli.main import command_of, main
from saltus.config import load_config
from saltus.effects.joint_loads import CoulombFriction
from saltus.effects.motors import TorqueGain
from saltus.effects.profile import EFFECTS, PARTS, load_profile
from saltus.heightmap import collection, device_collection
from saltus.heightmap.settings import ClosedLoop, DeviceCollection, ProcessorCollection
from saltus.policy.evaluation.evaluate import EvaluationSettings
from saltus.policy.training import checkpoint
from saltus.real2sim.cycle import choosing, finding, measuring, remote_training, training, trials
from saltus.real2sim.cycle.folder import CycleFolder
from saltus.real2sim.cycle.hidden_and_found import truth_rows
from saltus.real2sim.cycle.report import write_cycle_report
from saltus.real2sim.cycle.settings import CycleSettings
from saltus.real2sim.experiments import motions
from saltus.real2sim.experiments.menu import EXPERIMENTS
from saltus.real2sim.patch import PatchRange, ProfilePatch
from saltus.real2sim.search.findings import FoundEffect, ParameterInterval
from saltus.robots.loading import load_robot

pytestmark = pytest.mark.slow

HIDDEN = 0.4  # Nm
GAP = "gap 0.80 m"
TINY = (
    "--experiments", "single_sine", "--batches", "1", "--loop.robots", "12", "--loop.courses", "1",
    "--loop.ticks",
    "120", "--loop.camera", "ideal", "--predictor.updates", "2", "--predictor.batch", "2",
    "--policy-minutes", "0.02",
    "--trials", "1", "--choice-trials", "1",
)  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def _small(short_calibration: None) -> Any:
    """One course, of which a trial is the first 1.5 s; a short experiment.

    A processor in place of a GPU.
    """
    law = checkpoint.training_config

    def collect(settings: DeviceCollection, outputs: dict[str, Path], ticked: Any, _: Any) -> Any:
        (folder,) = outputs.values()
        assert settings.policy.exists()
        loop = ClosedLoop(
            robot="go1",
            grid="line",
            robots=12,
            courses=1,
            ticks=settings.loop.ticks,
            camera=settings.loop.cameras[0],
        )
        few = ProcessorCollection(
            batches=1, seed=settings.seed, profile=settings.profile, loop=loop
        )
        return collection.collect_shard(few, folder, lambda _: None, listener=ticked)

    sines = replace(
        EXPERIMENTS["single_sine"],
        sections=lambda robot: motions.repeat_motion("sine", 2, motions.sine(robot, 2.0, 1.0, 0.3)),
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(EXPERIMENTS, "single_sine", sines)
        for course in trials.COURSES.keys() - {GAP}:
            patch.delitem(trials.COURSES, course)
        patch.setattr(trials, "EvaluationSettings", partial(EvaluationSettings, time_limit_s=1.5))
        patch.setattr(gpu, "has_gpu", lambda: True)
        patch.setattr(device_collection, "collect_shards_on_device", collect)
        patch.setattr(
            checkpoint, "training_config", lambda state, *kind: replace(law(state, *kind), robots=8)
        )
        yield


def cycle(out: Path, *more: str) -> int:
    return main(["real2sim", "cycle", "--out", str(out), *more])


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cycle of a robot whose joints have friction that nobody knows of."""
    place = tmp_path_factory.mktemp("cycle")
    (place / "hidden.toml").write_text(f"[actuator.coulomb_friction]\ntorque = {HIDDEN}\n")
    assert (
        cycle(place / "run", "--hidden", str(place / "hidden.toml"), "--profile", "ideal", *TINY)
        == 0
    )
    return place / "run"


@pytest.fixture
def run(made: Path, tmp_path: Path) -> Path:
    """That cycle, for one test, which may go on with it."""
    return Path(shutil.copytree(made, tmp_path / "run"))


def results(out: Path, capsys: pytest.CaptureFixture[str], *more: str) -> dict[str, Any]:
    """What a cycle that goes on prints."""
    assert cycle(out, "--json", *more) == 0
    table: dict[str, Any] = json.loads(capsys.readouterr().out.splitlines()[-1])
    return table


def innermost(command: Any) -> Any:
    """What a group of commands was asked for."""
    return innermost(command.command) if hasattr(command, "command") else command


def test_what_is_hidden_is_found_trained_with_and_measured(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = results(run, capsys)
    (row,) = said["effects"]
    assert (row["effect"], row["known"], row["true"]) == ("coulomb_friction", 0.0, HIDDEN)
    assert row["found"] == pytest.approx(HIDDEN, rel=0.05)
    assert (said["found"]["verdict"], said["again"]["verdict"]) == ("named", "no_gap")
    assert said["models"] == dict.fromkeys(("heightmap", "policy"), "trained here")
    before, after = (said["courses"][GAP][when] for when in ("before", "after"))
    assert before["trials"] == after["trials"] == 1
    choice = said["choice"]
    assert choice["tallies"].keys() == {"heightmap+policy", "heightmap", "policy", ""}
    for kind in (
        "heightmap",
        "policy",
    ):  # networks of two updates are worse than the shipped ones, or no better
        assert before["models"][kind] != choice["models"][kind]
        assert (
            after["models"][kind] == (choice if kind in choice["taken"] else before)["models"][kind]
        )
    opens_without_a_network(run / "report.html")
    report = (run / "report.html").read_text()
    assert report.count("data:image/jpeg") == 12
    assert all(
        word in report for word in ("coulomb_friction", GAP, "1 of 1 hidden parameters found")
    )


def test_what_is_taken_is_never_worse_on_its_worst_course() -> None:
    rng, pairs = np.random.default_rng(4), ("heightmap+policy", "heightmap", "policy", "")

    def choice(table: dict[str, list[int]]) -> choosing.ModelChoice:
        tallies = {
            pair: {
                course: choosing.PairTally(successes=n, trials=3)
                for course, n in zip("abc", row, strict=True)
            }
            for pair, row in table.items()
        }
        return choosing.ModelChoice(models={}, tallies=tallies)

    for _ in range(200):
        table = {pair: rng.integers(0, 4, 3).tolist() for pair in pairs}
        taken = table["+".join(choice(table).taken)]
        best = max(min(row) for row in table.values())
        assert min(taken) == best
        assert sum(taken) == max(sum(row) for row in table.values() if min(row) == best)
    assert choice({pair: [3, 3, 3] for pair in pairs}).taken == ("heightmap", "policy")


def test_drives_are_made_up_for_where_that_is_better(tmp_path: Path) -> None:
    """A trained policy runs as it was trained.

    A shipped one with the drives made up for and without.
    """
    pairs = {
        "+".join(pair) for pair in choosing.pairs_of(("heightmap", "policy"), with_drives=True)
    }
    assert pairs == {
        "heightmap+policy+drives",
        "heightmap+drives",
        "policy+drives",
        "drives",
        "heightmap",
        "",
    }
    folder = measuring.CycleFolder(tmp_path, ROBOT)
    known, weak = load_profile("shipped", load_robot("go1")), TorqueGain(gain=0.7)
    folder.known.write_text(known.to_toml())
    for found, better, after in (
        (known.having(CoulombFriction(torque=HIDDEN)), "", folder.profile),
        (known.having(weak), "", folder.known),
        (known.having(weak), "drives", folder.profile),
    ):
        folder.profile.write_text(found.to_toml())
        assert choosing.finds_drives(folder) == ("torque_gain" in found.effects)
        tallies = {
            p: {GAP: choosing.PairTally(successes=int(p == better), trials=1)}
            for p in ("drives", "")
        }
        folder.choice.write_text(
            json.dumps(asdict(choosing.ModelChoice(models={}, tallies=tallies)))
        )
        assert measuring.known_of(folder, "after") == str(after)
        assert measuring.known_of(folder, "before") == str(folder.known)


def test_what_no_profile_can_have_is_said_and_the_rest_is_applied(tmp_path: Path) -> None:
    def found(name: str, **values: float) -> FoundEffect:
        params = {
            key: ParameterInterval(value=value, ci90=(value, value), unit="Nm")
            for key, value in values.items()
        }
        return FoundEffect(name=name, where="all", params=params)

    effects = (
        found("torque_saturation", knee=35.55, plateau=34.9),
        found("coulomb_friction", torque=HIDDEN),
    )
    shipped = load_profile("shipped", load_robot("go1"))
    patch, folder = (
        ProfilePatch(effects=effects, evidence=(), range=PatchRange()),
        measuring.CycleFolder(tmp_path, ROBOT),
    )
    patched, (refused,) = finding.apply_what_can_be(patch, shipped, ROBOT)
    assert refused.startswith("not applied: torque_saturation: ")
    assert patched == replace(shipped, actuator=(*shipped.actuator, CoulombFriction(torque=HIDDEN)))
    folder.found.mkdir()
    (folder.found / "patch.toml").write_text(patch.to_toml())
    (folder.found / "verdict.json").write_text(
        '{"verdict": "named", "gap": null, "untestable": []}'
    )
    folder.known.write_text(shipped.to_toml())
    folder.settings.write_text("")
    write_cycle_report(folder, CycleSettings(loop=ClosedLoop(robot="go1", grid="line")))
    assert html.escape(refused) in folder.report.read_text()


def test_what_is_done_is_not_repeated(
    run: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for module, name in (
        (finding, "find_effects"),
        (training, "collect_data"),
        (training, "train_predictor"),
    ):
        monkeypatch.setattr(module, name, None)  # cannot be called
    kept = {
        path: path.stat().st_mtime_ns
        for path in run.rglob("*")
        if path.suffix in (".onnx", ".csv", ".json")
    }
    capsys.readouterr()
    results(run, capsys)
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    first = measuring.read_measurement(measuring.CycleFolder(run, ROBOT), "before", GAP)
    more = results(run, capsys, "--trials", "2", "--choice-trials", "2")
    assert more["courses"][GAP]["before"]["trials"] == 2
    assert all(row[GAP]["trials"] == 2 for row in more["choice"]["tallies"].values())
    second = measuring.read_measurement(measuring.CycleFolder(run, ROBOT), "before", GAP)
    assert first is not None
    assert second is not None
    assert second.failures.items() > first.failures.items()
    assert cycle(run, "--batches", "3") == 2
    assert "begun with batches = 1, not 3" in capsys.readouterr().err


def test_logs_of_ones_own_are_trained_with_elsewhere(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    mine, away = tmp_path / "mine", tmp_path / "away"
    logs = ("--logs", str(run / "logs" / "single_sine"), "--profile", str(run / "profile.toml"))
    assert cycle(mine, *logs, *TINY, "--export-training", str(away)) == 0
    assert "nothing was found that could be added" in capsys.readouterr().out
    monkeypatch.chdir(away)
    lines = [line.strip() for line in Path("train.sh").read_text().splitlines()]
    commands = [
        shlex.split(line.replace("$begin", "policy.pt"))[1:]
        for line in lines
        if line.startswith("saltus")
    ]
    train, _, collect, *further = [innermost(command_of(command)) for command in commands]
    learning = train.training.learning
    assert (train.training.env.profile, learning.std_range) == (
        "profile.toml",
        (training.FURTHER_STD, 1.0),
    )
    assert train.training.env.curriculum.any_level == 1.0
    assert train.training.env.randomisation.wide.share == training.FURTHER_WIDE
    assert (learning.desired_kl, learning.last_kl) == (training.FURTHER_KL, training.FURTHER_KL)
    assert (collect.settings.policy, collect.settings.profile) == (
        Path("policy/checkpoint.pt"),
        "profile.toml",
    )
    assert len(further) == 2
    shutil.copytree(run / "dataset", "dataset")
    assert cycle(mine, "--take-training", str(away)) == 2
    assert "run its train.sh" in capsys.readouterr().err
    assert [main(command) for command in commands[3:]] == [0, 0]
    assert results(mine, capsys, "--take-training", str(away))["models"] == {
        "heightmap": "trained elsewhere",
        "policy": "as shipped",
    }
    assert "no profile of the robot was given" in (mine / "report.html").read_text()
    Path("profile.toml").write_text("")
    assert cycle(mine, "--take-training", str(away)) == 2
    assert "is not that of" in capsys.readouterr().err


@pytest.mark.parametrize(
    "name", [name for name, kind in EFFECTS.items() if PARTS[kind.site] != "heightmap"]
)
def test_the_policy_is_trained_where_more_than_the_camera_differs(
    name: str, tmp_path: Path
) -> None:
    """Of profiles that have an effect more than the shipped one, or one less."""
    folder, away = CycleFolder(tmp_path, ROBOT), tmp_path / "away"
    shipped, part = load_profile("shipped", load_robot("go1")), PARTS[EFFECTS[name].site]
    others = tuple(effect for effect in getattr(shipped, part) if effect.name != name)
    less = replace(shipped, **{part: others})
    folder.profile.write_text(
        (less if name in shipped.effects else shipped.having(EFFECTS[name]())).to_toml()
    )
    beyond = part != "camera"
    assert training.differs_beyond_camera(folder) == beyond
    remote_training.export_training(
        folder, CycleSettings(loop=ClosedLoop(robot="go1", grid="line"), policy_minutes=3.0), away
    )
    script, driver = (
        (away / "train.sh").read_text(),
        load_config(DeviceCollection, away / "collection.toml").policy,
    )
    assert driver == Path("policy/checkpoint.pt" if beyond else "policy.pt")
    assert (
        ("saltus policy train" in script)
        == ("--minutes 3 " in script)
        == (away / "policy.toml").exists()
        == beyond
    )
    subprocess.run(["/bin/bash", "-n", str(away / "train.sh")], check=True)


def test_a_log_of_another_robot_is_refused(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = shutil.copytree(run / "logs" / "single_sine", tmp_path / "log")
    claims = json.loads((log / "meta.json").read_text())
    (log / "meta.json").write_text(json.dumps(claims | {"robot": "my_robot.xml"}))
    assert cycle(tmp_path / "mine", "--logs", str(log), *TINY) == 2
    assert (
        "of the robot my_robot.xml; the models that a cycle trains are of go1"
        in capsys.readouterr().err
    )


def test_without_a_gpu_the_policy_stays_and_this_is_said(
    run: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gpu, "has_gpu", torch.cuda.is_available)
    (run / "trained.json").unlink()
    assert "no GPU" in results(run, capsys)["models"]["policy"]


def test_a_curve_is_told_only_where_it_was_hidden(tmp_path: Path) -> None:
    """The shipped profile has one, which is no number at each joint."""
    folder, shipped = (
        measuring.CycleFolder(tmp_path, ROBOT),
        load_profile("shipped", load_robot("go1")),
    )
    stronger = replace(
        shipped, actuator=tuple(e for e in shipped.actuator if e.name != "torque_saturation")
    )
    folder.found.mkdir()
    (folder.found / "patch.toml").write_text(
        ProfilePatch(effects=(), evidence=(), range=PatchRange()).to_toml()
    )
    (folder.found / "verdict.json").write_text(
        '{"verdict": "no_gap", "untestable": [], "misfits": [], "sets": []}'
    )
    folder.known.write_text(shipped.to_toml())
    for hidden, told in ((shipped, []), (stronger, ["torque_saturation curve"])):
        folder.hidden.write_text(hidden.to_toml())
        assert [row.name for row in truth_rows(folder)] == told
