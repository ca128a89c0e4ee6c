"""`saltus bench faults`: results are added to a file,
and recordings stay of runs that need to be looked at.
"""

import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks import faults
from benchmarks._judgement import FaultResult
from saltus.recordings.recorder import RECORDING_FILE


def test_recordings_stay_of_runs_that_used_something_too_old(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    killed: list[tuple[str, int]] = []

    def kill(config: Any, directory: Path, process: str, *_: Any, **__: Any) -> tuple[str, int]:
        (directory / RECORDING_FILE).write_text(f"{process} {config.seed}")
        killed.append((process, config.seed))
        return killed[-1]

    def judged(recording: tuple[str, int], process: str, after_s: float) -> FaultResult:
        return FaultResult(
            process=process, running_s=after_s, told_ms=90.0, reported_ms=1.0, silence_ms=99.0,
            end="stands",
            stale=int(recording == ("policy", 8)), back_s=0.5,
        )  # fmt: skip

    monkeypatch.setattr(faults, "kill_during_run", kill)
    monkeypatch.setattr(faults, "judge", judged)
    out = tmp_path / "faults.jsonl"
    for trials in (1, 2):
        table = faults.Benchmark(trials=trials, seed=7, out=out).measure()["faults"]
    assert sorted(killed) == [
        (process, seed) for process in ("heightmap", "policy", "render") for seed in (7, 8)
    ]
    assert [table[process]["stale"] for process in ("heightmap", "policy", "render")] == [0, 1, 0]
    assert [path.name for path in tmp_path.glob("*.mcap")] == ["flat-policy-8.mcap"]
    assert (tmp_path / "flat-policy-8.mcap").read_text() == "policy 8"
    assert len([json.loads(line) for line in out.read_text().splitlines()]) == 6
