"""`saltus doctor`: what is missing is told apart by who needs it."""

import json

import pytest

from saltus.cli import doctor
from saltus.cli.main import main


@pytest.fixture(autouse=True)
def _nothing_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "_attempts", lambda: [])


def without(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        doctor, "package_version", lambda asked: "missing" if asked == name else "1.0"
    )


def test_an_optional_package_that_is_missing_is_no_failure(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    without("torch", monkeypatch)
    assert main(["doctor"]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "torch" in line]
    assert line.split(maxsplit=2) == [
        "-",
        "torch",
        "optional, not installed  -> pip install 'saltus[train]'",
    ]


def test_a_package_that_all_commands_need_is_a_failure(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    without("numpy", monkeypatch)
    assert main(["doctor", "--json"]) == 1
    findings = json.loads(capsys.readouterr().out.splitlines()[-1])["findings"]
    (numpy,) = [finding for finding in findings if finding["name"] == "numpy"]
    assert (numpy["ok"], numpy["optional"], numpy["detail"]) == (False, False, "not installed")
