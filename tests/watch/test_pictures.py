"""What stands beside the robot in a video: drawn from what is known at an instant,
and nothing else.
"""

from dataclasses import replace

import numpy as np
import pytest
from recorded import STEPS, run_samples, write

from saltus.watch.pictures import BESIDE, INK, PALETTE, PREDICTED, TRUE, UNTRUSTED, video_panel
from saltus.watch.scene import Scene
from saltus.watch.source import RecordedRun
from saltus.wire.messages import HeightmapStatus


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RecordedRun:
    return RecordedRun(
        write(tmp_path_factory.mktemp("run") / "recording.mcap", list(run_samples())).path
    )


def pixels(run: RecordedRun, scene: Scene, colour: tuple[int, int, int]) -> int:
    page = video_panel(run.world, scene)
    assert page.shape == (BESIDE[1], BESIDE[0], 3)
    return int((page == colour).all(axis=-1).sum())


def test_every_scene_has_a_page_of_the_same_size(run: RecordedRun) -> None:
    pages = [video_panel(run.world, run.at(0.01 * step)) for step in range(STEPS)]
    assert {page.shape for page in pages} == {(BESIDE[1], BESIDE[0], 3)}
    assert len({page.tobytes() for page in pages}) == STEPS  # time goes on


def test_heights_have_the_colour_of_their_status(run: RecordedRun) -> None:
    scene = run.at(0.01 * (STEPS - 1))
    assert scene.heights is not None
    for status in HeightmapStatus:
        shown = replace(scene, heights=replace(scene.heights, status=status))
        usable = status in (HeightmapStatus.OK, HeightmapStatus.DEGRADED)
        assert (pixels(run, shown, PREDICTED) > 100) == usable
        assert (pixels(run, shown, UNTRUSTED) > 100) == (not usable)


def test_only_what_is_known_is_drawn(run: RecordedRun) -> None:
    scene = run.at(0.01 * (STEPS - 1))
    assert scene.heights is not None
    unknown = replace(scene, heights=replace(scene.heights, true=None))
    assert pixels(run, scene, TRUE) > 100 > pixels(run, unknown, TRUE)
    empty = replace(
        scene, heights=None, depth=None, mode=None, speed_mps=float("nan"), base_pose=None
    )
    assert pixels(run, empty, PREDICTED) == 0
    assert pixels(run, empty, INK) > 0


@pytest.mark.parametrize("shape", [(240, 80), (80, 240), (1, 1), (480, 848)])
def test_a_depth_image_of_any_shape_is_drawn_in_the_colours_of_its_scale(
    run: RecordedRun, shape: tuple[int, int]
) -> None:
    scene = run.at(0.01 * (STEPS - 1))
    assert scene.depth is not None
    depth = np.full(shape, round(0.2 / scene.depth.depth_unit_m), np.uint16)  # the nearest colour
    shown = replace(scene, depth=replace(scene.depth, depth=depth))
    red, green, blue = PALETTE[255].tolist()
    brightest = (red, green, blue)
    assert pixels(run, shown, brightest) > pixels(run, replace(scene, depth=None), brightest) + 1000
