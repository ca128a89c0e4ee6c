"""The stack with the learned policy: it plans, it bounds, and it repeats to the bit."""

import json
from pathlib import Path

import pytest

from saltus.cli.main import main
from saltus.config import RunConfig, load

FLAGS = ["demo", "--terrain", "flat", "--planner", "learned", "--seed", "3", "--time-limit-s", "2.5"]


def test_two_lockstep_runs_with_the_learned_policy_are_equal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tables = []
    for name in ("first", "second"):
        main([*FLAGS, "--no-video", "--json", "--out", str(tmp_path / name)])
        tables.append(json.loads(capsys.readouterr().out.splitlines()[-1]))
    first, second = tables
    assert load(RunConfig, tmp_path / "first" / "run.toml").planner == "learned"
    assert first["digest"] == second["digest"] != ""
    assert first["distance_m"] == second["distance_m"] > 1.0  # 1 s of standing, then at more than 1 m/s
