"""A family of terrain that an installed package names is one like any other:
looked at, run, measured, trained on.
"""

import json
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from samples import ROBOT

from saltus.cli.main import main
from saltus.config import TerrainConfig
from saltus.errors import ConfigError
from saltus.grid import LINE
from saltus.heightmap.data.device_rollouts import _curriculum
from saltus.heightmap.data.shards import read_dataset
from saltus.heightmap.settings import DeviceLoop
from saltus.policy.csv_tables import read_csv_table
from saltus.policy.env.curriculum import CurriculumSettings
from saltus.policy.env.jump_env import JumpEnv
from saltus.policy.env.settings import JumpEnvSettings
from saltus.recordings.recording import read_recording
from saltus.sim.cpu_engine import CpuEngine
from saltus.terrain.course_batch import BOXES
from saltus.terrain.course_law import KINDS
from saltus.terrain.course_table import VARIANTS, CourseTable
from saltus.terrain.curriculum import find_family, make_terrain
from saltus.terrain.terrain import Terrain

EXAMPLE = Path(__file__).parents[2] / "examples" / "beams"
BEAMS = TerrainConfig(terrain="beams", difficulty=0.2, layout_seed=3)
BAD = {
    "missing": "",
    "broken": "def make(difficulty, rng): return 1 / 0",
    "listed": "def make(difficulty, rng): return [1]",
    "high": "from beams import make as beams\nfrom dataclasses import replace\n"
    "def make(difficulty, rng): return replace(t := beams(difficulty, rng), "
    "start_x=t.boxes[1].low[0] + 0.06)",
}


@pytest.fixture(autouse=True)
def installed(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What `pip install ./examples/beams` puts into a folder of packages,
    where this and all processes look.
    """
    folder = tmp_path_factory.mktemp("packages")
    shutil.copy(EXAMPLE / "beams.py", folder)
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]
    entries = project["entry-points"]["saltus.terrains"]
    for name, text in BAD.items():
        (folder / f"{name}.py").write_text(text)
        entries[name] = f"{name}:make"
    about = folder / f"{project['name']}-{project['version']}.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    )
    lines = [f"{name} = {value}" for name, value in entries.items()]
    (about / "entry_points.txt").write_text("\n".join(["[saltus.terrains]", *lines, ""]))
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setenv("PYTHONPATH", str(folder), prepend=":")
    return folder


def run(capsys: pytest.CaptureFixture[str], *command: object) -> dict[str, object]:
    main([str(word) for word in command])
    table: dict[str, object] = json.loads(capsys.readouterr().out.splitlines()[-1])
    return table


def test_difficulty_and_layout_seed_make_it() -> None:
    one, same = make_terrain(BEAMS), make_terrain(BEAMS)
    assert one == same
    assert one.boxes[1].high[2] == pytest.approx(0.08)
    assert make_terrain(TerrainConfig(terrain="beams", difficulty=0.2, layout_seed=4)) != one
    assert make_terrain(TerrainConfig(terrain="beams")).boxes[1].high[2] == pytest.approx(0.14)


@pytest.mark.parametrize(
    ("terrain", "told"),
    [
        ("beam", "did you mean 'beams'"),
        ("missing", r"'missing' \(missing:make\) failed: AttributeError"),
        ("broken", "ZeroDivisionError: division by zero"),
        ("listed", "returned list"),
        ("high", "at the start is"),
    ],
)
def test_what_is_no_family_is_refused_in_one_line(terrain: str, told: str) -> None:
    with pytest.raises(ConfigError, match=told) as error:
        make_terrain(TerrainConfig(terrain=terrain))
    assert "\n" not in str(error.value)


def test_it_has_no_sizes() -> None:
    with pytest.raises(ConfigError, match=r"rise_m = 0\.1 has no meaning for terrain 'beams'"):
        make_terrain(TerrainConfig(terrain="beams", rise_m=0.1))


@pytest.mark.slow
def test_it_is_looked_at_and_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    course = ("--terrain", "beams", "--difficulty", "0.2", "--layout-seed", "3")
    assert main(["render", "preview", *course, "--out", str(tmp_path / "preview")]) == 0
    flags = (
        "--camera",
        "ideal",
        "--time-limit-s",
        "0.3",
        "--no-video",
        "--json",
        "--out",
        tmp_path / "run",
    )
    table = run(capsys, "demo", *course, *flags)
    assert table["terrain"] == "beams"
    assert read_recording(tmp_path / "run" / "recording.mcap").terrain == make_terrain(BEAMS)


@pytest.mark.slow
def test_each_trial_draws_its_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flags = (
        "--terrain",
        "beams",
        "--difficulty",
        "0",
        "--trials",
        "2",
        "--json",
        "--out",
        tmp_path,
    )
    table = run(capsys, "policy", "eval", *flags)
    assert (table["terrain"], table["trials"], table["params"]) == ("beams", 2, {"difficulty": 0.0})


@pytest.mark.slow
def test_predictors_are_measured_and_trained_on_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ("--terrains", "beams", "--runs", "1", "--baselines", "--time-limit-s", "1.2", "--json")
    table = run(capsys, "heightmap", "eval", *flags, "--processes", "1")
    assert table["by_terrain"].keys() == {"beams"}  # type: ignore[attr-defined]
    loop = {"terrains": "beams", "robots": "1", "courses": "1", "ticks": "70", "camera": "ideal"}
    words = [part for name, value in loop.items() for part in (f"--loop.{name}", value)]
    command = [
        "heightmap",
        "collect",
        "cpu",
        "--batches",
        "1",
        "--processes",
        "1",
        "--out",
        str(tmp_path),
        *words,
    ]
    assert main(command) == 0
    assert {episode.terrain for episode in read_dataset(tmp_path)} == {"beams"}


@pytest.mark.slow
def test_a_policy_is_trained_on_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("saltus.policy.training.training_record.REPORT_S", 0.0)
    others = [
        word for kind in KINDS for word in (f"--env.curriculum.{kind.replace('_', '-')}", "0")
    ]
    tiny = ("--device", "cpu", "--robots", "8", "--learning.hidden", "8", "--learning.horizon", "2")
    flags = (
        *tiny,
        *others,
        "--env.curriculum.own",
        "beams",
        "1",
        "--iterations",
        "2",
        "--out",
        str(tmp_path),
    )
    assert main(["policy", "train", *flags]) == 0
    assert "beams L" in (tmp_path / "log.txt").read_text()
    more = tmp_path / "more"
    resumed = ("--resume", str(tmp_path / "checkpoint.pt"), "--iterations", "3", "--out", str(more))
    assert main(["policy", "train", *resumed]) == 0
    for folder in (tmp_path, more):
        assert float(read_csv_table(folder / "progress.csv")[-1]["beams/level"]) >= 0.0


@pytest.mark.parametrize("library", [np.asarray, torch.as_tensor], ids=["numpy", "torch"])
def test_a_table_holds_the_courses(library: Callable[..., object]) -> None:
    table = CourseTable.of(("beams",), 3, 0.6, BOXES)
    assert table.boxes == BOXES
    level = np.repeat(np.arange(3.0), VARIANTS)
    place = table.draw(
        np.zeros(len(level)), level, np.tile((np.arange(VARIANTS) + 0.5) / VARIANTS, 3)
    )
    assert place.tolist() == list(range(3 * VARIANTS))
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-1.0, 8.0, (len(place), 40)), rng.uniform(-2.0, 2.0, (len(place), 40))
    heights = (
        table.like(library(x)).ground.of_robot(library(place)).height_at(library(x), library(y))
    )
    tops = np.array([terrain_of(table, i).height_at(x[i], y[i]) for i in place])
    np.testing.assert_allclose(np.asarray(heights), tops, atol=1e-12)


def terrain_of(table: CourseTable, course: int) -> Terrain:
    """What the family made for a place in the table."""
    level, variant = divmod(course, VARIANTS)
    rng = np.random.default_rng([level, variant])
    return find_family("beams")(0.6 * (level + rng.uniform()) / table.levels, rng)


def test_robots_stand_on_their_own_courses_and_on_those_of_saltus() -> None:
    curriculum = CurriculumSettings(
        flat=1.0, stairs=0.0, stepping_stones=0.0, step=0.0, gap=0.0, own={"beams": 1.0}
    )
    assert curriculum.shares["beams"] == 0.5 * sum(curriculum.shares.values())
    env = JumpEnv(
        CpuEngine(ROBOT, 8, curriculum.boxes, threads=1),
        JumpEnvSettings(curriculum=curriculum),
        LINE,
        seed=0,
    )
    x = torch.linspace(0.0, 6.0, 500).expand(8, -1)
    highest = env.courses().height_at(x, torch.zeros_like(x)).amax(-1)
    assert (highest[:4] == 0.0).all()
    assert (highest[4:] > 0.03).all()
    for _ in range(20):
        transition = env.step(torch.zeros(8, 10))
    assert torch.isfinite(transition.actor).all()
    assert (env.memory.finish_x[:4] == 8.0).all()
    assert (env.memory.finish_x[4:] < 9.0).all()


def test_rollouts_on_a_device_take_the_same_families() -> None:
    usual, own = (
        _curriculum(DeviceLoop(robot="go1", grid="line")),
        _curriculum(DeviceLoop(robot="go1", grid="line", terrains=("beams", "beams", "gap"))),
    )
    assert usual.shares == dict.fromkeys(KINDS, 1.0) | {"stairs": 2.0, "stepping_stones": 2.0}
    assert {kind: share for kind, share in own.shares.items() if share} == {
        "gap": 1.0,
        "beams": 2.0,
    }
