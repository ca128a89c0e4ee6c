"""`saltus bench train`: what it prints."""

import json

import pytest

from saltus.cli.main import main


@pytest.mark.slow
def test_says_where_the_time_of_training_goes(capsys: pytest.CaptureFixture[str]) -> None:
    flags = ["--device", "cpu", "--robots", "8", "--iterations", "1"]
    assert main(["bench", "train", "--", *flags, "--json"]) == 0
    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert set(report) == {"engine", "robots", "steps_per_s", "ms"}
    assert (report["engine"], report["robots"]) == ("CpuEngine", 8)
    assert report["steps_per_s"] > 0
    assert set(report["ms"]) == {"physics", "controller", "observation", "policy", "learning"}
    assert all(value > 0.0 for value in report["ms"].values())
