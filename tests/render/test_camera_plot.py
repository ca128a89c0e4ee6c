"""The picture of a camera says what its colours mean."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from samples import ROBOT

from saltus.config import TerrainConfig
from saltus.depth_camera import load_camera
from saltus.grid import LINE
from saltus.render.camera_plot import BAR, MEANINGS, draw_camera
from saltus.render.preview import Scale
from saltus.terrain.curriculum import make_terrain

EXAMPLE = str(Path(__file__).parents[2] / "examples" / "camera.toml")
TERRAIN = make_terrain(TerrainConfig(terrain="stairs", rise_m=0.1))


@pytest.mark.parametrize("name", ["ideal", "d435i", EXAMPLE])
def test_every_colour_is_explained_below_the_panels(name: str, tmp_path: Path) -> None:
    camera = load_camera(name)
    draw_camera(camera.mounted_on(ROBOT), LINE, TERRAIN, camera, tmp_path / "camera.png")
    picture = cv2.imread(str(tmp_path / "camera.png"))
    assert picture is not None
    legend = picture[-60:]
    bar, squares = legend[6 : 6 + BAR[1], 10 : 10 + BAR[0]], legend[:, 10 + BAR[0] :]
    assert (bar == bar[:1]).all()
    ends = Scale(near=0.3, far=1.0).coloured(np.array([[0.3, 1.0]]))[0]  # the same colours, whatever they stand for
    np.testing.assert_array_equal(bar[0, [0, -1]], ends)
    assert len(np.unique(bar[0], axis=0)) > 200
    for colour in MEANINGS.values():
        assert (squares == colour).all(axis=-1).sum() >= 11 * 11
    assert (legend[:, -1] == 255).all()  # nothing is cut off at the side or below
    assert (legend[-1] == 255).all()
