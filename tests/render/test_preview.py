import base64
import itertools
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from report_pages import opens_without_a_network
from samples import ROBOT

from saltus.cli.main import main
from saltus.config import TerrainConfig
from saltus.depth import D435I
from saltus.depth_camera import SHIPPED, load_camera
from saltus.render.camera import RobotCamera
from saltus.render.preview import (
    EFFECTS_VIEW,
    DepthColours,
    effect_stages,
    make_viewpoints,
    view_poses,
    write_preview,
)
from saltus.render.stereo.camera import StereoConfig
from saltus.render.stereo.optics import StereoOptics
from saltus.render.stereo_embree import StereoEmbree
from saltus.terrain.curriculum import make_terrain

TERRAIN = make_terrain(TerrainConfig(terrain="gap", difficulty=0.3))
VIEWS = make_viewpoints(ROBOT)
EXAMPLE = str(Path(__file__).parents[2] / "examples" / "camera.toml")
EFFECTS = StereoConfig().effects


def pictures(page: str) -> list[np.ndarray]:
    found = re.findall(r"<img [^>]*data:image/webp;base64,([^\"]+)", page)
    return [
        cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
        for data in found
    ]


def test_a_page_has_every_view_every_effect_and_a_cloud(tmp_path: Path) -> None:
    page = write_preview(ROBOT, TERRAIN, SHIPPED["d435i"], tmp_path / "preview.html").read_text()
    robots, seen = pictures(page)[: len(VIEWS)], pictures(page)[len(VIEWS) :]
    assert [image.shape[:2] for image in robots] == [(240, 320)] * len(VIEWS)
    assert all(np.abs(a.astype(int) - b).max() > 100 for a, b in itertools.combinations(robots, 2))
    assert [image.shape[:2] for image in seen[: 2 * len(VIEWS)]] == [(240, 424), (48, 16)] * len(
        VIEWS
    )
    assert len(seen) == 2 * len(VIEWS) + len(EFFECTS) + 2
    assert [image.shape[:2] for image in seen[-2:]] == [(48, 16)] * 2
    # There is something to see
    assert all(len(np.unique(image.reshape(-1, 3), axis=0)) > 20 for image in seen)
    assert all(effect.name.replace("_", " ") in page for effect in EFFECTS)
    assert "scatter3d" in page
    opens_without_a_network(tmp_path / "preview.html")


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["ideal", EXAMPLE])
def test_a_page_is_of_the_camera_that_is_named(name: str, tmp_path: Path) -> None:
    camera = load_camera(name)
    path = tmp_path / "preview.html"
    assert (
        main(["render", "preview", "--camera", name, "--terrain", "gap", "--out", str(tmp_path)])
        == 0
    )
    seen = pictures(path.read_text())[len(VIEWS) :]
    size = camera.matching.height, camera.matching.width
    assert [image.shape[:2] for image in seen[: 2 * len(VIEWS)]] == [size, (48, 16)] * len(VIEWS)
    effects = [effect for effect in StereoConfig.of(camera).effects if not effect.is_null()]
    assert len(seen) == 2 * len(VIEWS) + len(effects) + 2
    # Rows of the model that the camera does not see are invalid
    uncovered = (seen[-1] == 0).all(axis=(1, 2))
    assert uncovered.tolist() == [name == EXAMPLE, *[False] * 46, name == EXAMPLE]


def test_every_effect_changes_the_picture() -> None:
    robot = tuple(array[EFFECTS_VIEW] for array in view_poses(TERRAIN, VIEWS))
    depth, hidden = StereoEmbree(
        TERRAIN, StereoOptics.of(D435I), RobotCamera.on(ROBOT, D435I)
    ).render_pair(*robot)
    images = [depth, *(image for _, _, image in effect_stages(depth, hidden, SHIPPED["d435i"]))]
    assert len(images) == 1 + len(EFFECTS)
    changed = [bool((before != after).any()) for before, after in itertools.pairwise(images)]
    # the filters before the temporal one leave no hole for it to fill
    assert changed == [effect.name != "temporal_filter" for effect in EFFECTS]


def test_nothing_is_grey_invalid_is_black_and_near_is_bright() -> None:
    shown = np.array([[np.inf, 0.0, 0.3, 1.2]], dtype=np.float32)
    nothing, invalid, near, far = DepthColours.of([shown]).coloured(shown)[0].tolist()
    assert nothing[0] == nothing[1] == nothing[2] > 0
    assert invalid == [0, 0, 0]
    assert sum(near) > 2 * sum(far) > 0


def test_depth_has_all_colours_from_the_nearest_to_the_farthest_that_is_shown() -> None:
    depth = np.geomspace(0.25, 0.9, 256, dtype=np.float32)[None]
    colours = DepthColours.of([depth]).coloured(depth)[0]
    assert len(np.unique(colours, axis=0)) > 200
    for nothing_to_span in (np.full((2, 2), np.inf, np.float32), np.ones((2, 2), np.float32)):
        DepthColours.of([nothing_to_span]).coloured(nothing_to_span)
