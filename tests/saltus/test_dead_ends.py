"""Where a command can do nothing it says so, and what to do."""

import json
from pathlib import Path
from typing import Any

import pytest

from saltus.cli import watch
from saltus.cli.main import main
from saltus.errors import SaltusError
from saltus.robots.loading import load_robot
from saltus.wire import router


@pytest.mark.parametrize(
    ("pitch", "image", "code"),
    [(0.5, "", 0), (1.2, "", 0), (-1.2, "", 1), (0.5, "fov_deg = [0.2, 0.2]", 1)],
)
def test_a_camera_that_sees_no_point_is_told(
    pitch: float, image: str, code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    camera = tmp_path / "camera.toml"
    camera.write_text(
        f"camera_pitch = {pitch}\n"
        + (f"[image]\nwidth = 64\nheight = 64\n{image}\n" if image else "")
    )
    assert main(["camera", "show", str(camera), "--out", str(tmp_path / "out"), "--json"]) == code
    told = capsys.readouterr()
    assert bool(json.loads(told.out.splitlines()[-1])["points_in_view_m"]) == (code == 0)
    assert told.err.count("\n") == code
    assert (
        "sees none of the 30 points of the heightmap, from -0.4 to 0.8 m ahead" in told.err
    ) == bool(code)


def test_a_router_for_another_robot_says_that_nothing_serves_heights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def enough(*_: Any) -> Any:
        raise SaltusError("enough")

    monkeypatch.setattr(router, "open_router", enough)
    (tmp_path / "robot.toml").write_text('name = "mine"\nmjcf = "mine.xml"\n')
    (tmp_path / "mine.xml").write_text(load_robot("go1").mjcf)
    for robot, lines in (("go1", 1), (str(tmp_path), 2)):
        assert main(["router", "--robot", robot, "--out", str(tmp_path / "out")]) == 2
        told = capsys.readouterr().err.splitlines()
        assert len(told) == lines
        assert told[-1] == "saltus: enough"
    assert told[0].startswith("saltus: the line cannot be served here: ")
    assert "heightmap collect cpu --loop.learned 0" in told[0]


def test_what_is_waited_for_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "begun").mkdir()
    (tmp_path / "begun" / "run.toml").touch()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").touch()
    (tmp_path / "about to begin").mkdir()
    (tmp_path / "recording.mcap").touch()
    names = ("begun", "about to begin", "other", "recording.mcap", "nowhere")
    watch.tell_of_no_run([tmp_path / name for name in names])
    other, nowhere = capsys.readouterr().err.splitlines()
    assert f"there is no run in '{tmp_path / 'other'}' yet: waiting for one to begin there" in other
    assert f"there is no '{tmp_path / 'nowhere'}' yet" in nowhere
    assert f"saltus up --out {tmp_path / 'nowhere'}" in nowhere
