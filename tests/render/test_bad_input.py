"""What no back end can render is refused in one line that names it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from render.backends import make_renderer
from render.camera import Mount
from render.embree import EmbreeRenderer
from render.renderer import Renderer
from saltus import go1
from saltus.cli.main import main
from saltus.config import TerrainConfig
from saltus.depth import MODEL_CAMERA
from saltus.errors import SaltusError
from saltus.terrain.curriculum import make_terrain

FLAT = make_terrain(TerrainConfig(terrain="flat"))
STAIRS = make_terrain(TerrainConfig(terrain="stairs"))
POSE = np.array([0.0, 0.0, 0.3]), np.array([1.0, 0.0, 0.0, 0.0]), go1.STAND_POSE
BACK_ENDS = ("embree", "pyrender", "warp")


def with_value(values: Any, place: int, value: float) -> Any:
    changed = np.array(values)
    changed[place] = value
    return changed


def one_line(error: pytest.ExceptionInfo[SaltusError]) -> str:
    message = str(error.value)
    assert message
    assert "\n" not in message
    return message


@pytest.mark.parametrize("back_end", BACK_ENDS)
@pytest.mark.parametrize(
    ("terrain", "named"),
    [
        (replace(STAIRS, column_top=with_value(STAIRS.column_top, 3, np.nan)), "column_top is nan at place 3"),
        (replace(STAIRS, column_x=with_value(STAIRS.column_x, 2, np.inf)), "column_x is inf at place 2"),
        (replace(STAIRS, column_x=STAIRS.column_x[::-1]), "ascending"),
        (replace(STAIRS, column_top=STAIRS.column_top[1:]), "one more than columns"),
        (replace(STAIRS, width=float("nan")), "width is nan"),
    ],
)
def test_terrain(back_end: str, terrain: Any, named: str) -> None:
    with pytest.raises(SaltusError) as error:
        make_renderer(back_end, terrain)
    assert named in one_line(error)


@pytest.mark.parametrize("back_end", BACK_ENDS)
@pytest.mark.parametrize(
    ("name", "value"), [("fx", 0.0), ("fy", -1.0), ("fx", np.nan), ("cx", np.inf), ("width", 0), ("height", -48)]
)
def test_camera(back_end: str, name: str, value: float) -> None:
    with pytest.raises(SaltusError) as error:
        make_renderer(back_end, FLAT, replace(MODEL_CAMERA, **{name: value}))
    assert f"{name} = {value}" in one_line(error)


@pytest.mark.parametrize("position", [[0.0, 0.0, 0.0], [0.18, 0.04, -0.05]])
def test_camera_inside_the_robot(position: list[float]) -> None:
    with pytest.raises(SaltusError) as error:
        EmbreeRenderer(FLAT, mount=Mount(position=np.array(position)))
    assert "inside the robot" in one_line(error)


@pytest.mark.parametrize(
    "mount", [Mount(pitch=float("nan")), Mount(position=np.array([np.nan, 0.0, 0.2]))], ids=["pitch", "position"]
)
def test_mount(mount: Mount) -> None:
    with pytest.raises(SaltusError) as error:
        EmbreeRenderer(FLAT, mount=mount)
    assert "finite" in one_line(error)


@pytest.fixture(params=BACK_ENDS)
def renderer(request: pytest.FixtureRequest) -> Any:
    back_end = make_renderer(request.param, FLAT)
    yield back_end
    back_end.close()


@pytest.mark.parametrize("argument", range(3))
def test_poses(renderer: Renderer, argument: int) -> None:
    broken = [array.copy() for array in POSE]
    broken[argument][1] = np.nan
    with pytest.raises(SaltusError) as error:
        renderer.render(*broken)
    assert "of pose 0" in one_line(error)
    broken[argument] = POSE[argument][1:]
    with pytest.raises(SaltusError) as error:
        renderer.render(*broken)
    assert "shape" in one_line(error)


@pytest.mark.parametrize("name", ["missing.bag", "missing.mcap", "notes.txt"])
def test_fit_of_what_is_no_recording(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "notes.txt").write_text("nothing")
    assert main(["render", "fit", str(tmp_path / name)]) == 2
    printed = capsys.readouterr().err
    assert name in printed
    assert printed.count("\n") == 1
