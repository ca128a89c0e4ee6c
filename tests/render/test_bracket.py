"""Brackets of any robot whose camera a plate on its trunk can hold."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from saltus.cli.main import main
from saltus.errors import ConfigError
from saltus.render.bracket import (
    BASE_MM,
    CAMERA_MM,
    IMAGER_ASIDE_MM,
    MM,
    PLATE_MM,
    Bracket,
    slotted,
)
from saltus.render.bracket_drawing import bracket_svg
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot

DRAWING = Path(__file__).parents[2] / "docs" / "images" / "go2_bracket.svg"


def drawn(seed: int) -> Robot:
    """A Go2 with its camera somewhere above and ahead of the trunk."""
    rng = np.random.default_rng(seed)
    place = np.array([rng.uniform(0.1, 0.3), rng.uniform(-0.04, 0.04), rng.uniform(0.12, 0.2)])
    return replace(
        load_robot("go2"), camera_position=place, camera_pitch=float(rng.uniform(0.0, 1.0))
    )


@pytest.mark.parametrize("seed", range(30))
def test_every_part_is_closed_and_stays_out_of_the_camera_and_the_trunk(seed: int) -> None:
    bracket = Bracket(robot=drawn(seed))
    mesh = bracket.mesh()
    parts = mesh.split(only_watertight=False)
    assert len(parts) == 4
    assert all(part.is_watertight and part.volume > 1000.0 for part in parts)
    forward, left, up = bracket.axes.T
    assert ((mesh.vertices - bracket.back) @ forward).max() < 1e-6
    assert mesh.vertices[:, 2].min() == pytest.approx(bracket.top)
    assert mesh.bounds[0, 0] == pytest.approx(bracket.end - BASE_MM[0])
    lens = MM * bracket.robot.camera_position - bracket.back
    assert lens @ forward == pytest.approx(CAMERA_MM[0] - 4.2)
    assert lens @ left == pytest.approx(IMAGER_ASIDE_MM)
    assert lens @ up == pytest.approx(0.0, abs=1e-9)


def test_slots_go_right_through() -> None:
    slots = [(10.0, 5.0, 4.0, 2.0), (20.0, 5.0, 4.0, 3.0)]
    plate = slotted(30.0, 10.0, slots)
    assert plate.is_watertight
    assert plate.volume == pytest.approx(PLATE_MM * (300.0 - 8.0 - 12.0))
    assert plate.euler_number == 2 - 2 * len(slots)


def test_a_camera_that_no_bracket_holds_is_refused() -> None:
    robot = load_robot("go2")
    low = replace(robot, camera_position=np.array([0.24, 0.0, 0.06]))
    for wrong, told in (
        (low, "put the camera higher"),
        (replace(robot, camera_roll=0.1), "without roll and yaw"),
        (replace(robot, camera_pitch=-0.2), "0 to 75 degrees down"),
    ):
        with pytest.raises(ConfigError, match=told):
            Bracket(robot=wrong)


def test_the_command_writes_both_files_and_the_page_shows_its_drawing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["camera", "mount", "--robot", "go2", "--out", str(tmp_path)]) == 0
    assert "51.9 mm ahead of the trunk's front and 63.0 mm above" in capsys.readouterr().out
    assert (tmp_path / "bracket.stl").stat().st_size > 5000
    made = (tmp_path / "bracket.svg").read_text(encoding="utf-8")
    assert (
        made == DRAWING.read_text(encoding="utf-8") == bracket_svg(Bracket(robot=load_robot("go2")))
    )
