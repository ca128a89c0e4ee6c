"""The page of a camera shows what it sees, and says what its colours mean."""

import base64
import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from report_pages import opens_without_a_network
from samples import ROBOT

from saltus.config import TerrainConfig
from saltus.depth_camera import load_camera
from saltus.grid import LINE
from saltus.render.camera_plot import ENLARGED, FRAME, draw_camera
from saltus.terrain.curriculum import make_terrain

EXAMPLE = str(Path(__file__).parents[2] / "examples" / "camera.toml")
TERRAIN = make_terrain(TerrainConfig(terrain="stairs", rise_m=0.1))


@pytest.mark.parametrize("name", ["ideal", "d435i", EXAMPLE])
def test_a_page_has_both_images_and_the_view_from_aside(name: str, tmp_path: Path) -> None:
    camera, path = load_camera(name), tmp_path / "camera.html"
    coverage = draw_camera(camera.mounted_on(ROBOT), LINE, TERRAIN, camera, path)
    opens_without_a_network(path)
    page = path.read_text(encoding="utf-8")
    data = re.findall(r"<img [^>]*data:image/webp;base64,([^\"]+)", page)
    framed, network = (
        cv2.imdecode(np.frombuffer(base64.b64decode(d), np.uint8), cv2.IMREAD_COLOR) for d in data
    )
    assert framed.shape[:2] == (ENLARGED * camera.image.height, ENLARGED * camera.image.width)
    assert network.shape[:2] == (48, 16)
    assert (framed == FRAME).all(axis=-1).any()
    assert all(len(np.unique(image.reshape(-1, 3), axis=0)) > 20 for image in (framed, network))
    traces = {
        trace["name"]: trace
        for trace in json.loads(re.findall(r"Plotly.newPlot\([^\[]*(\[.*?\]), +\{", page)[0])
    }
    assert {"terrain", "trunk", "camera", "edges of the network's view"} <= traces.keys()
    seen, unseen = (
        traces[f"heightmap points {words}"]["x"] for words in ("in view", "not in view")
    )
    assert (_length(seen), _length(unseen)) == (coverage.visible.sum(), (~coverage.visible).sum())


def _length(numbers: dict[str, str] | list[float]) -> int:
    """Length of an array of a figure, which plotly may write as bytes."""
    return (
        len(numbers) if isinstance(numbers, list) else len(base64.b64decode(numbers["bdata"])) // 4
    )
