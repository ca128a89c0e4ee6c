"""What is counted in images: copies, ends of the range, repeats."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from saltus.arrays import Floats
from saltus.real2sim.problem.camera.edges import filled_share, plain_pixels, reach_px
from saltus.real2sim.problem.camera.log_images import frames_of
from saltus.real2sim.problem.camera.pixels import clip_guess
from saltus.recordings.run_log import DepthTable

SHAPE = (60, 30, 90)


def noisy(kind: str, rng: np.random.Generator) -> Floats:
    """Images of a wall at 1.4 to 1.6 m, with noise of 1.5 mm that is as real as `kind` says [m]."""
    noise = rng.standard_normal(SHAPE)
    if kind == "alike beside each other":
        noise = gaussian_filter1d(noise, 0.8, axis=2)
        noise /= noise.std()
    if kind == "with a memory":
        for k in range(1, len(noise)):
            noise[k] = 0.7 * noise[k - 1] + 0.71 * noise[k]
    return np.linspace(1.4, 1.6, SHAPE[1])[:, None] + 1.5e-3 * noise


def in_mm(depth_m: Floats, holes: Floats, reach: int) -> np.ndarray:
    """Rounded images with holes that are filled from the left."""
    images = np.where(holes, 0.0, np.rint(1e3 * depth_m))
    for _ in range(reach):
        images[..., 1:] = np.where(images[..., 1:] == 0.0, images[..., :-1], images[..., 1:])
    return images.astype(np.uint16)


@pytest.mark.parametrize("kind", ["white", "alike beside each other", "with a memory"])
@pytest.mark.parametrize("reach", [0, 1, 3])
def test_copies_are_told_from_neighbours_that_noise_makes_equal(kind: str, reach: int) -> None:
    rng = np.random.default_rng(7)
    share = 0.03
    wall = np.broadcast_to(np.linspace(1.4, 1.6, SHAPE[1])[:, None], SHAPE)
    images = in_mm(noisy(kind, rng), rng.random(SHAPE) < share, reach)
    plain = plain_pixels(wall, images, 4.0)
    found = filled_share(wall, images, plain, np.inf)
    assert found is not None
    expected = share * (1.0 - share * (reach == 1)) if reach else 0.0
    assert found.share == pytest.approx(expected, abs=4.0 * found.deviation)
    assert found.deviation < 0.2 * share


def test_depth_in_steps_says_nothing_of_copies() -> None:
    rng = np.random.default_rng(8)
    wall = np.broadcast_to(np.linspace(1.4, 1.6, SHAPE[1])[:, None], SHAPE)
    images = in_mm(3e-3 * np.rint(noisy("white", rng) / 3e-3), np.zeros(SHAPE, dtype=bool), 0)
    assert filled_share(wall, images, plain_pixels(wall, images, 4.0), np.inf) is None


@pytest.mark.parametrize("reach", [0.0, 0.4, 1.0, 1.7, 2.0])
def test_what_is_left_of_single_holes_tells_how_far_a_filter_reaches(reach: float) -> None:
    lost, pixels = 0.02, 1e7
    whole = int(reach)
    left = lost ** (1 + whole) * (1.0 - (reach - whole) * (1.0 - lost))
    assert reach_px(pixels * left, pixels, lost) == pytest.approx(reach, abs=1e-6)


@pytest.mark.parametrize(
    ("end_m", "found"), [(1.55, 1.55), (1.601, None), (4.0, None), (9.0, None)]
)
def test_an_end_of_the_range_is_a_pile_of_equal_depths(end_m: float, found: float | None) -> None:
    # at 1.601 m there is nothing left to cut but noise, and 4 m are claimed
    depth = noisy("white", np.random.default_rng(9)) + (end_m == 4.0) * 3.0
    images = np.rint(1e3 * np.minimum(depth, end_m)).astype(np.uint16)
    assert clip_guess(images, 4.0) == (None if found is None else pytest.approx(found))


def test_a_repeat_in_the_place_of_a_lost_image_is_lost_once() -> None:
    kept = np.random.default_rng(5).random(300) > 0.25
    kept[[0, -1]] = True
    source = np.maximum.accumulate(np.where(kept, np.arange(300), 0))
    images = np.random.default_rng(6).integers(500, 900, (300, 4, 5)).astype(np.uint16)
    # a temporal filter has changed the repeats: only their numbers tell
    table = DepthTable(
        arrival_s=0.02 * np.arange(300), capture_s=None, frame_id=source, depth_mm=images
    )
    frames = frames_of(table)
    np.testing.assert_array_equal(frames.lost, ~kept)
    np.testing.assert_array_equal(frames.index[frames.shown], source)
    assert len(frames.filtered) == 300
