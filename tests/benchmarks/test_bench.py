"""`saltus bench`: it lists every benchmark, shows each one's help, and runs it."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks._command import Command
from saltus.cli import checkout
from saltus.cli.main import main
from saltus.cli.output import print_figures
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.data.shards import write_shard
from saltus.heightmap.service.proprioception_vector import PROPRIOCEPTION

FOLDER = checkout.SOURCE / "benchmarks"
NAMES = sorted(
    [p.stem for p in FOLDER.glob("[!_]*.py")] + [p.parent.name for p in FOLDER.glob("*/command.py")]
)
TINY = {
    "qp": "--problems 20 --ticks 20 --robots 4",
    "inference": "--ticks 440",
    "landing": "--phases 1 --trials 1 --planner scripted --run-s 0.3",
    "render": "--backend embree --noise none --seconds 0.01 --batch 2 --frames 8",
    "render_fit": "--cameras 1 --frames 10",
    "render_noise": "",
    "stance_batched": "--robots 4 --steps 2",
    "feedback": "--seconds 0.2",
}
"""Those that take seconds.

What only runs the real processes, trains or searches is left to `saltus bench`.
"""
BAD = {
    "no such benchmark": ("qpp", "did you mean 'qp'?"),
    "unknown flag": ("qp --problem 3", "--problems"),
    "none at all": ("qp --problems 0", "problems = 0"),
    "not a number": ("landing --run-s nan", "run_s = nan"),
    "faster than real time": ("soak --speed 2", "speed = 2"),
    "negative seed": ("stack --seed -1", "seed = -1"),
    "too few batches": ("collect --processes 2 --batches 2", "batches = 2"),
    "no training": ("training_curve nowhere", "nowhere"),
    "no dataset": ("restart nowhere", "nowhere"),
    "no truths": ("left_out nowhere nowhere", "nowhere"),
    "no policy to run": ("stand_in nowhere", "nowhere"),
    "no effect of the stand-in": (
        "stand_in --left-out viscous_frictoin",
        "did you mean 'viscous_friction'?",
    ),
    "no such row": ("hard_courses --rows stairs", "no row 'stairs'"),
    "no policy": ("hard_courses --models nowhere", "nowhere"),
    "no heightmap model": (
        "hard_courses --heightmap predicted --heightmap-model nowhere",
        "nowhere",
    ),
    "no trials": (f"hard_courses --out {Path(__file__)}", "holds no trials"),
    "no other policy": ("heights --other-policy nowhere", "no file nowhere"),
    "no batches": (f"heights --out {Path(__file__)}", "holds no batches"),
    "no models": ("other_robots --models nowhere", "nowhere"),
    "no verdicts": ("hidden_effects score nowhere nowhere", "nowhere"),
}


def figures(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    assert main(["bench", *words, "--json"]) == 0
    table: dict[str, Any] = json.loads(capsys.readouterr().out.splitlines()[-1])
    return table


def test_every_benchmark_is_listed_with_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench"]) == 0
    lines = [line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines()]
    assert [name for name, _ in lines] == NAMES
    assert all(about.endswith(".") for _, about in lines)


@pytest.mark.parametrize("name", NAMES)
def test_each_has_a_help_with_an_example(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["bench", name, "--help"])
    assert stopped.value.code == 0
    shown = capsys.readouterr().out
    assert shown.startswith(f"usage: saltus bench {name} ")
    lines = [line.strip().removeprefix("OMP_NUM_THREADS=1 ") for line in shown.splitlines()]
    assert any(line.startswith(f"saltus bench {name}") for line in lines)


@pytest.mark.slow
@pytest.mark.parametrize("name", TINY)
def test_those_that_take_seconds_end_with_one_json_object(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert figures(capsys, name, "--", *TINY[name].split())


@pytest.mark.parametrize("case", BAD, ids=str)
def test_bad_input_is_one_line_and_exit_code_2(
    case: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words, hint = BAD[case]
    assert main(["bench", *words.split()]) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1)
    assert hint in said.err


def test_figures_of_the_leg_controller(capsys: pytest.CaptureFixture[str]) -> None:
    found = figures(capsys, "qp", "--problems", "30", "--ticks", "5", "--robots", "2")
    assert 0.0 < found["worst_difference_n"] < 1e-3
    assert found["solve"]["p50_us"] <= found["solve"]["p99_us"]


def test_without_the_other_solver_forces_are_not_compared(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("benchmarks.qp.quadprog", None)
    assert main(["bench", "qp", "--problems", "2", "--ticks", "2", "--robots", "2", "--json"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out.splitlines()[-1])["worst_difference_n"] is None
    assert "pip install quadprog" in said.err


def test_a_network_that_loses_its_hidden_state(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng, ticks = np.random.default_rng(0), 180
    episode = Episode(
        terrain="flat",
        proprioception=rng.normal(size=(ticks, len(PROPRIOCEPTION))),
        height=rng.normal(size=(ticks, 30)),
        depth=rng.integers(300, 2500, (ticks // 2, 48, 16)).astype(np.uint16),
        frame_tick=np.arange(0, ticks, 2, dtype=np.int32),
    )
    write_shard(
        tmp_path, [episode, replace(episode, height=episode.height[:100])], seed=0, config={}
    )
    (row,) = figures(capsys, "restart", str(tmp_path))["models"]
    assert row["episodes"] == 1
    assert row["worse_by"]["0"] != 0.0


def test_a_training_is_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = [
        "iteration",
        "steps",
        "seconds",
        *(f"flat/{n}" for n in ("way_m", "speed", "level", "finished")),
    ]
    (tmp_path / "progress.csv").write_text(
        "\n".join([",".join(names), "1,2,3,4,5,6,0.7", "8,9,10,11,12,13,0.9"])
    )
    found = figures(
        capsys, "training_curve", str(tmp_path), "--picture", str(tmp_path / "curve.png")
    )
    assert found["steps"] == 9.0
    assert found["terrains"] == {
        "flat": {"way_m": 11.0, "speed": 12.0, "level": 13.0, "finished": 0.9}
    }
    assert (tmp_path / "curve.png").stat().st_size > 10_000


def test_hidden_effects_take_their_flags(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: dict[str, Any] = {}
    monkeypatch.setattr(
        "benchmarks.hidden_effects.command.generate", lambda *_, **options: asked.update(options)
    )
    words = ["--seed", "3", "--runs", "2", "--kinds", "joints", "imu", "--jobs", "1", "--tuning"]
    folders = ["--out", str(tmp_path / "logs"), "--truth", str(tmp_path / "truth")]
    assert figures(capsys, "hidden_effects", "--", "generate", *words, *folders)["runs"] == 2
    assert asked == {"tuning": True, "jobs": 1}


def test_a_wheel_says_where_benchmarks_and_the_paper_are(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(checkout, "SOURCE", tmp_path)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "benchmarks").mkdir()  # somebody else's
    assert main(["bench", "qp"]) == 2
    assert "in a checkout of saltus" in capsys.readouterr().err
    assert main(["paper", "staircase"]) == 2
    assert capsys.readouterr().err.endswith("run `saltus paper` in a checkout of saltus\n")
    monkeypatch.chdir(FOLDER.parent)
    assert main(["bench"]) == 0


def test_a_package_that_is_not_installed_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delitem(sys.modules, "benchmarks.train", raising=False)
    monkeypatch.setitem(sys.modules, "torch", None)
    assert main(["bench", "train"]) == 2
    said = capsys.readouterr().err
    assert "'torch', which is not installed" in said
    assert "saltus[train]" in said


def test_a_picture_without_matplotlib_is_refused_before_the_work(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    assert main(["bench", "feedback", "--picture", "feedback.png"]) == 2
    assert "pip install matplotlib" in capsys.readouterr().err


def test_figures_as_text(capsys: pytest.CaptureFixture[str]) -> None:
    print_figures(
        {
            "load": 0.25,
            "none": None,
            "law": {"p50": 1.0, "p99": float("nan")},
            "rows": {
                "flat": {"success": 20, "failures": {}},
                "gap 0.2 m": {"success": 3, "failures": {"fell": 17}},
            },
        }
    )
    assert capsys.readouterr().out.splitlines() == [
        "load  0.25",
        "none  -",
        "law   p50 1, p99 -",
        "rows:",
        "             success  failures",
        "  flat            20         -",
        "  gap 0.2 m        3   fell 17",
    ]


def test_a_command_measures() -> None:
    with pytest.raises(TypeError, match="measure"):
        Command()  # type: ignore[abstract]
