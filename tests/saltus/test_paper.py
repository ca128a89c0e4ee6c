"""`saltus paper`: every row says where its numbers come from,
what can be made is made, and jumps are counted right.
"""

import html
import json
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from report_pages import opens_without_a_network

from paper import ablations, drawing, edges, making, motion, new_ground, run_figures, sysid
from paper.ablations import STAND_IN, files_of, trainings_of
from paper.drawing import save, subplots
from paper.making import check_makeable, is_makeable, made_before, make, number_at
from paper.report import write_report
from paper.rows import ABLATION, BY_NAME, NEEDS, ROWS, SOURCES, Row
from paper.runs import FIRST_SEED, Effort, Ran, Setting, ran
from paper.stand_in import stand_in
from paper.training import ABLATIONS, FULL, IMITATION, PUBLISHED
from saltus.cli.main import main
from saltus.config import TerrainConfig
from saltus.effects.image_delivery import CameraLatency
from saltus.effects.profile import Profile
from saltus.errors import SaltusError
from saltus.policy.evaluation.trial_trace import TrialTrace
from saltus.provenance import current_commit
from saltus.real2sim.experiments.menu import experiment_named
from saltus.real2sim.experiments.run import run_experiment
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.terrain.curriculum import make_terrain

SEARCHED = ("torque-saturation", "camera-latency")


"""Searches take half a minute; `tests/real2sim` tests them."""


FROM_SHIPPED = [row for row in ROWS if row.needs == "nothing"]


MADE = [row for row in FROM_SHIPPED if row.name not in SEARCHED]


def test_each_row_has_a_name_of_its_own_and_says_where_its_numbers_were_measured() -> None:
    assert len({row.name for row in ROWS}) == len(ROWS)
    for row in ROWS:
        assert row.needs in NEEDS
        assert (row.needs == "nothing" or row.name == "learning-curves") == bool(row.make)
        assert row.needs == ABLATION or row.name not in ABLATIONS
        assert row.make or row.missing
        assert all(number.source in SOURCES for number in row.numbers)
        assert row.trial or not row.numbers or not row.make, "what was simulated says so"


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody looks at these figures."""
    monkeypatch.setattr(drawing, "DPI", 40)


@pytest.fixture(scope="module")
def climbed() -> Ran:
    terrain = make_terrain(TerrainConfig(terrain="stairs", steps=3, rise_m=0.15, run_m=0.4))
    ((one,),) = ran([Setting(terrain=terrain)], Effort(trials=1, processes=1))
    return one


def begun(whole: Ran) -> Ran:
    rows, trace = 130, whole.trace  # a third of a second after it has stood
    short = {
        name: getattr(whole, name)[:rows] for name in ("reference", "velocity", "frequency_hz")
    }
    outcome = replace(whole.outcome, success=False, cause="ended")
    cut = TrialTrace(**{name: values[:rows] for name, values in vars(trace).items()})
    return replace(whole, outcome=outcome, failure="timeout", trace=cut, **short)


@pytest.mark.slow
@pytest.mark.parametrize("good", [True, False])
@pytest.mark.parametrize("row", MADE, ids=lambda row: row.name)
def test_a_row_is_made_of_trials_that_succeed_and_that_fail(
    row: Row, good: bool, climbed: Ran, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = climbed if good else begun(climbed)

    def run_none(settings: Sequence[Setting], effort: Effort) -> list[list[Ran]]:
        return [[one] * max(effort.trials, len(setting.starts_x)) for setting in settings]

    for module in (edges, motion):
        monkeypatch.setattr(module, "ran", run_none)
    check_makeable(row, tmp_path, tmp_path)
    result = make(row, Effort(trials=2, time_limit_s=1.3), tmp_path)
    assert made_before(row, tmp_path) == json.loads(json.dumps(result))
    one_seed = row.name in ("gap-footsteps", "step-and-gap")
    assert result["seeds"] == [FIRST_SEED, FIRST_SEED + (0 if one_seed else 1)]
    assert (tmp_path / f"{row.name}.png").stat().st_size > 1000


def test_jumps_are_landings_on_the_course(climbed: Ran) -> None:
    assert climbed.outcome.success
    assert climbed.edges_passed == 3
    edges = climbed.terrain.edges_x
    on_it = [landing for landing in climbed.landings("front") if edges[0] <= landing.x < edges[-1]]
    assert climbed.jumps == len(on_it) + 1 <= 4
    for landing in on_it:  # a foot stands on a stair, not in it or above it
        assert abs(landing.z - climbed.terrain.height_at(landing.x, 0.0) - 0.02) < 0.03
    times = [climbed.time_at(x) for x in edges]
    assert times == sorted(times)
    assert np.isnan(climbed.time_at(1e3))


def test_every_number_of_ours_that_stands_beside_the_papers_is_among_the_published_results() -> (
    None
):
    published = {path.stem: json.loads(path.read_text()) for path in PUBLISHED.glob("*.json")}
    assert (
        published.keys()
        == {row.name for row in ROWS if is_makeable(row, None)}
        > {row.name for row in FROM_SHIPPED}
    )
    for row in (row for row in ROWS if row.name in published):
        for number in row.numbers:
            assert (
                not number.ours
                or number_at(published[row.name]["numbers"], number.ours) is not None
            ), number
    assert all(not result["commit"].endswith("+") for result in published.values())
    for row in (row for row in ROWS if row.needs == ABLATION and row.name in published):
        for system, trainings in published[row.name]["configuration"]["trainings"].items():
            assert trainings == trainings_of(system, PUBLISHED / "trainings"), (
                "measured again since the last training"
            )
            files = files_of(system, PUBLISHED / "trainings")
            if system != IMITATION:  # whose seed stands in its weights
                seeds = [config_file(of_one_seed[0])["seed"] for of_one_seed in files]
                assert seeds == [known["seed"] for known in trainings]


@pytest.mark.sample(3)
@pytest.mark.parametrize(
    "row", [row for row in ROWS if row.needs == ABLATION], ids=lambda row: row.name
)
def test_the_page_shows_published_results_of_ablations_without_measuring_them(
    row: Row, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ablations, "ran", None)
    if is_makeable(row, None):
        numbers = make(row, Effort(), tmp_path, again=False)["numbers"]
        assert numbers == json.loads((PUBLISHED / f"{row.name}.json").read_text())["numbers"]


def config_file(policy: Path) -> dict[str, Any]:
    return tomllib.loads((policy.parent / "config.toml").read_text())


def test_the_lag_of_heights_is_the_latency_that_was_hidden() -> None:
    robot, latency = load_robot(DEFAULT_ROBOT), 0.09
    log = run_experiment(
        experiment_named("heave_sine"), robot, Profile(camera=(CameraLatency(latency=latency),))
    )
    joints_s, by_joints = sysid._height_by_joints(log, robot)
    images_s, by_images = sysid._height_by_images(log)
    assert np.abs(by_images.mean() - by_joints.mean()) < 0.01
    # Half an image
    assert abs(sysid._lag(images_s, by_images, joints_s, by_joints) - latency) < 0.01


def test_planks_leave_open_what_stairs_fill() -> None:
    planks = new_ground.plank_stairs()
    solid = make_terrain(run_figures.STAIRS)
    x = np.linspace(0.0, planks.finish_x, 501)
    np.testing.assert_allclose(planks.height_at(x, 0.0 * x), solid.height_at(x, 0.0 * x), atol=1e-9)
    between = [box for box in planks.boxes if box.low[2] > 0.0]
    assert len(between) == 14
    assert all(box.high[2] - box.low[2] < 0.05 for box in between)


def put(row: Row, folder: Path, **changes: Any) -> None:
    numbers = {"success": 3, "trials": 4, "jumps": {"least": 7, "median": 7.5, "most": 8}}
    result = {
        "row": row.name,
        "commit": "c0ffee",
        "seeds": [1, 4],
        "models": making._models(),
        "numbers": numbers,
    }
    result["configuration"] = {}
    (folder / f"{row.name}.json").write_text(json.dumps(result | changes))
    figure, axis = subplots()
    axis.plot((0, 1), (0, 1))
    save(figure, folder / f"{row.name}.png")


def test_the_page_never_mixes_a_robot_with_a_simulation(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for row in FROM_SHIPPED:
        put(row, tmp_path)
    assert (
        main(
            [
                "paper",
                "report",
                "--out",
                str(tmp_path),
                "--trained",
                str(tmp_path / "none"),
                "--json",
            ]
        )
        == 0
    )
    *_, said, table = capsys.readouterr().out.splitlines()
    assert Path(said) == tmp_path / "report.html"
    assert json.loads(table).keys() == {row.name for row in FROM_SHIPPED}
    opens_without_a_network(tmp_path / "report.html")
    page = html.unescape((tmp_path / "report.html").read_text())
    parts = page.split("<h2")[1:]
    assert len(parts) == len(ROWS)
    for row, part in zip(ROWS, parts, strict=True):
        assert row.shows in part
        assert ("<img" in part) == (row in FROM_SHIPPED)
        assert row in FROM_SHIPPED or html.escape(row.missing) in part
        for number in (
            row.numbers
        ):  # the paper's number, where it was measured; ours, and that it is simulated
            ours = ("7.5", "simulation") if number.ours == "jumps.median" else ("-", "-")
            cells = "".join(
                f"<td>{cell}</td>" for cell in (number.what, number.paper, number.source, *ours)
            )
            assert cells in part


def test_the_page_says_at_its_head_what_each_part_is_worth(tmp_path: Path) -> None:
    rows = [
        row.name
        for row in ROWS
        if row.needs == ABLATION and (PUBLISHED / f"{row.name}.json").exists()
    ]
    for name in rows:
        (tmp_path / f"{name}.png").write_bytes(b"drawn")
    results = {name: json.loads((PUBLISHED / f"{name}.json").read_text()) for name in rows}
    head = write_report(results, tmp_path).read_text().split("<h2")[1]
    for system, places in results["transfer"]["numbers"].items():
        (figures,) = places.values()
        told = f"{sum(figures['success'])} of {figures['trials'] * len(figures['success'])} ("
        (line,) = (
            line for line in head.split("<tr>") if line.lstrip().startswith(f"<td>{system}</td>")
        )
        _, _, against, simulated, stood_in, difference = line.split("<td>")[:6]
        assert told in stood_in
        assert simulated[0].isdigit()
        if system in BY_NAME and system != FULL:
            (other,) = results[system]["numbers"].keys() - {system}
            assert against.startswith(f"{other}<")
            parts = [results[system]["numbers"][each][STAND_IN] for each in (system, other)]
            own, whole = (
                100.0 * sum(part["success"]) / part["trials"] / len(part["success"])
                for part in parts
            )
            assert difference.split("<")[0].endswith(f", {own - whole:+.0f}")


def test_a_page_takes_no_rows_of_other_models_and_no_files_of_others(tmp_path: Path) -> None:
    row = BY_NAME["staircase"]
    assert made_before(row, tmp_path) is None
    put(row, tmp_path, models={"policy": "other", "heightmap": "other"})
    assert made_before(row, tmp_path) is None
    for junk in ("{}", "[1]", "junk", '{"row": "stones"}', "\x00"):
        (tmp_path / "staircase.json").write_text(junk)
        with pytest.raises(SaltusError, match="holds no row of the paper"):
            made_before(row, tmp_path)


def test_the_list_says_what_is_not_made(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["paper"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == [row.name for row in ROWS]
    assert all(row.needs in line for row, line in zip(ROWS, lines, strict=True))


@pytest.mark.parametrize(
    "row", [row for row in ROWS if row.needs != "nothing"], ids=lambda row: row.name
)
def test_what_is_not_made_says_so_in_a_line(
    row: Row, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = ["--out", str(tmp_path / "out"), "--trained", str(tmp_path)]
    assert main(["paper", row.name, *folders]) == 2
    said = capsys.readouterr().err
    if row.needs == ABLATION:
        command = f"saltus paper train {FULL} --seed 0 (GPU)"
        assert said == f"saltus: no results in {tmp_path / FULL}: make them with {command}\n"
    else:
        assert said == f"saltus: '{row.name}' is not made yet: {row.differs}\n"
    assert not (tmp_path / "out").exists()


def test_an_ablation_is_measured_beside_the_full_system(
    climbed: Ran, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Setting] = []

    def run_none(settings: Sequence[Setting], effort: Effort) -> list[list[Ran]]:
        asked.extend(settings)
        runs = [
            replace(run, seed=seed)
            for run, seed in zip((climbed, begun(climbed)), effort.seeds, strict=True)
        ]
        return [runs for _ in settings]

    monkeypatch.setattr(ablations, "ran", run_none)
    for name, seeds in ((FULL, 2), ("no-feedback", 1)):
        for seed in range(seeds):
            put_policy(tmp_path, name, seed)
    row = BY_NAME["no-feedback"]
    check_makeable(row, tmp_path / "out", tmp_path)
    result = make(row, Effort(trials=2), tmp_path / "out", tmp_path)
    assert [len(result["configuration"]["trainings"][name]) for name in (FULL, "no-feedback")] == [
        2,
        1,
    ]
    for system, seeds in ((FULL, 2), ("no-feedback", 1)):
        for where in ("simulation", "simulated stand-in"):
            assert result["numbers"][system][where] == {
                "success": [1] * seeds,
                "trials": 2,
                "interval95_percent": [15.0, 85.0] if seeds == 2 else [9.5, 90.5],
                "steps": 1.5,
                "steps_of_each_seed": [1.5] * seeds,
                "trial_seeds": [FIRST_SEED, FIRST_SEED + 1],
                "commits": [current_commit()] * seeds,
            }
    assert [setting.feedback for setting in asked] == [True] * 4 + [False] * 2
    assert sum(setting.profile == stand_in() for setting in asked) == 3
    asked.clear()
    transfer = make(BY_NAME["transfer"], Effort(trials=5, first_seed=7), tmp_path / "out", tmp_path)
    where = "simulated stand-in"
    assert transfer["seeds"] == [FIRST_SEED, FIRST_SEED + 1], (
        "of the trials that are shown, not of those that were asked for"
    )
    assert transfer["numbers"] == {
        name: {where: result["numbers"][name][where]} for name in (FULL, "no-feedback")
    }
    assert (
        make(row, Effort(trials=2), tmp_path / "out", tmp_path, again=False)["numbers"]
        == result["numbers"]
    )
    assert not asked, "what was measured is not measured again"
    published = tmp_path / "out" / "no-feedback.json"
    for kind, measured_again in (
        ("policy", 0),
        ("heightmap", 6),
    ):  # the policy that runs is the training
        published.write_text(
            published.read_text().replace(making._models()[kind], f"another {kind}")
        )
        make(row, Effort(trials=2), tmp_path / "out", tmp_path, again=False)
        assert len(asked) == measured_again, (
            "what ran with a network that is shipped no more is measured again"
        )
        asked.clear()
    make(row, Effort(trials=2), tmp_path / "out", tmp_path)
    assert [setting.feedback for setting in asked] == [False] * 2, (
        "the other system is taken as it is"
    )
    asked.clear()
    put_policy(tmp_path, FULL, 2)
    make(row, Effort(trials=2), tmp_path / "out", tmp_path, again=False)
    assert [setting.feedback for setting in asked] == [True] * 2, (
        "one more training is run alone, in both places"
    )
    asked.clear()
    put_policy(tmp_path, FULL, 3)
    make(row, Effort(trials=2, first_seed=FIRST_SEED + 1), tmp_path / "out", tmp_path, again=False)
    assert [setting.feedback for setting in asked] == [True] * 8, "of other trials nothing is taken"
    asked.clear()
    file = tmp_path / "out" / "no-feedback.json"
    file.write_text(file.read_text().replace('"commits"', '"commit"'))
    make(row, Effort(trials=2), tmp_path / "out", tmp_path, again=False)
    assert [setting.feedback for setting in asked] == [True] * 8 + [False] * 2, (
        "nothing is taken of an older form"
    )


def put_policy(trained: Path, name: str, seed: int) -> None:
    (trained / name / f"seed-{seed}").mkdir(parents=True)
    (trained / name / f"seed-{seed}" / "policy.onnx").write_bytes(bytes([seed]))
