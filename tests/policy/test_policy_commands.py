"""`saltus policy`: what it prints, writes and refuses."""

import json
from pathlib import Path

import pytest
from report_pages import opens_without_a_network

from saltus.cli.main import main
from saltus.model_file import ModelFile

SHIPPED = Path(__file__).parents[2] / "models/checkpoints/policy.pt"
KEYS = {"terrain", "params", "trials", "success_rate", "mean_speed_mps", "time_s", "failures"}
STONES = ("--terrain", "stepping_stones", "--steps", "1", "--gap-m", "0.05", "--gap-max-m", "0.1")


@pytest.mark.sample(1)
@pytest.mark.parametrize("heightmap", ["true-exact", "predicted"])
def test_eval_crosses_easy_stones_and_reports(
    heightmap: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = [
        "--planner",
        "learned",
        "--trials",
        "2",
        "--heightmap",
        heightmap,
        "--out",
        str(tmp_path),
        "--json",
    ]
    assert main(["policy", "eval", *STONES, *flags, "--processes", "1"]) == 0
    table = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert table.keys() >= KEYS
    assert table["params"] == {"steps": 1, "stone_m": 0.5, "gap_m": 0.05, "gap_max_m": 0.1}
    assert (table["success_rate"], table["failures"]) == (1.0, {})
    assert table["time_s"]["p50"] > 0.0
    report = (tmp_path / "report.html").read_text()
    assert "2 of 2 trials succeeded" in report
    opens_without_a_network(tmp_path / "report.html")


def test_eval_without_a_success_names_no_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    high = (
        "--terrain",
        "step",
        "--height-m",
        "1.0",
        "--planner",
        "scripted",
        "--trials",
        "1",
        "--out",
        str(tmp_path),
    )
    assert main(["policy", "eval", *high, "--processes", "1"]) == 1
    last = capsys.readouterr().out.splitlines()[-2]
    assert last.startswith("0 of 1 succeeded (0 to 79 %); failed: 1 ")
    assert "unknown" in (tmp_path / "report.html").read_text()


def test_train_and_export_make_a_policy_that_loads(tmp_path: Path) -> None:
    flags = [
        "--robots",
        "16",
        "--iterations",
        "1",
        "--device",
        "cpu",
        "--out",
        str(tmp_path / "run"),
    ]
    assert main(["policy", "train", *flags]) == 0
    checkpoint, out = tmp_path / "run/checkpoint.pt", tmp_path / "exported"
    assert main(["policy", "export", "--checkpoint", str(checkpoint), "--out", str(out)]) == 0
    assert ModelFile(out / "policy.onnx").field("iteration") == 1
