"""The post-filters against plain scans, pixel by pixel,
of what librealsense documents and does on 16-bit depth.
"""

from typing import Any

import numpy as np
import pytest

from saltus.effects.signals import DepthImage
from saltus.render.postfilter import HOLE_RADIUS, HoleFilling, SpatialFilter, TemporalFilter

UNIT = 1e-3


def holed(seed: int, share: float, shape: tuple[int, int] = (24, 30), spread: int = 400) -> Any:
    """Whole units with holes: single ones, and blocks, some of which touch a border."""
    rng = np.random.default_rng(seed)
    image = rng.integers(500, 500 + spread, shape)
    image[rng.random(shape) < share] = 0
    for _ in range(4):
        row, column = rng.integers(0, shape[0]), rng.integers(0, shape[1])
        image[row : row + rng.integers(1, 12), column : column + rng.integers(1, 12)] = 0
    return image


def signal(image: Any, time_s: float = 0.0) -> DepthImage:
    return DepthImage(
        depth=(image * np.float32(UNIT)).astype(np.float32), time_s=np.asarray(time_s)
    )


def units(image: DepthImage) -> Any:
    count = np.round(np.asarray(image.depth) / UNIT)
    np.testing.assert_allclose(image.depth, count * UNIT, rtol=1e-5)
    return count.astype(int)


def scan_hole_filling(image: Any) -> Any:
    image = image.copy()
    for row in range(1, image.shape[0] - 1):
        for column in range(1, image.shape[1]):
            if image[row, column] == 0 and image[row - 1, column] > 0:
                around = [
                    image[row - 1, column],
                    image[row - 1, column - 1],
                    image[row, column - 1],
                ]
                around += [image[row + 1, column - 1], image[row + 1, column]]
                image[row, column] = min(value for value in around if value > 0)
    return image


def scan_rows(image: Any, alpha: float, delta: int, radius: int) -> None:
    width = image.shape[1]
    for line in image:
        for columns in (range(1, width - 1), range(width - 2, -1, -1)):
            step, filled = (1 if columns.step > 0 else -1), 0
            for column in columns:
                before, value = line[column - step], line[column]
                if value > 0:
                    filled = 0
                    if before > 0 and abs(value - before) <= delta:
                        line[column] = int(value * alpha + before * (1.0 - alpha) + 0.5)
                elif before > 0:
                    filled += 1
                    if filled < radius:
                        line[column] = before


def scan_columns(image: Any, alpha: float, delta: int) -> None:
    for line in image.T:
        for rows in (range(1, len(line)), range(len(line) - 2, -1, -1)):
            step = 1 if rows.step > 0 else -1
            for row in rows:
                before, value = line[row - step], line[row]
                if before > 0 and value > 0 and abs(value - before) < delta:
                    line[row] = int(value * alpha + before * (1.0 - alpha) + 0.5)


def scan_spatial(image: Any, magnitude: int, alpha: float, delta: int, radius: int) -> Any:
    image = image.copy()
    for _ in range(magnitude):
        scan_rows(image, alpha, delta, radius)
        scan_columns(image, alpha, delta)
    return image


class ScanTemporal:
    def __init__(self, alpha: float, delta: int) -> None:
        self.alpha, self.delta = alpha, delta
        self.kept: Any = None
        self.agreed: Any = None

    def step(self, image: Any) -> Any:
        if self.kept is None:
            self.kept, self.agreed = image.copy(), [[[bool(v)] for v in line] for line in image]
            return image
        out = image.copy()
        for index in np.ndindex(image.shape):
            value, before = int(image[index]), int(self.kept[index])
            agreed = self.agreed[index[0]][index[1]]
            if value and before and abs(value - before) < self.delta:
                out[index] = self.kept[index] = int(
                    self.alpha * value + (1.0 - self.alpha) * before
                )
                agreed.append(True)
            elif value:
                self.kept[index] = value
                agreed[:] = [True]
            else:
                if before and sum(agreed[-4:]) >= 2:
                    out[index] = before
                agreed.append(False)
        return out


@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 0.8])
@pytest.mark.parametrize("seed", range(5))
def test_hole_filling_is_the_scan(seed: int, share: float) -> None:
    image = holed(seed, share)
    filled, _ = HoleFilling(mode=2.0).apply(signal(image), 0.0, None)
    np.testing.assert_array_equal(units(filled), scan_hole_filling(image))


def test_hole_filling_of_a_batch_is_that_of_its_images() -> None:
    stack = np.stack([holed(seed, 0.1) for seed in range(6)]).reshape(2, 3, 24, 30)
    filled = units(HoleFilling(mode=2.0).apply(signal(stack), 0.0, None)[0])
    for index in np.ndindex(2, 3):
        np.testing.assert_array_equal(filled[index], scan_hole_filling(stack[index]))


@pytest.mark.parametrize("level", range(1, 5))
@pytest.mark.parametrize("seed", range(3))
def test_spatial_filter_at_the_originals_settings_only_fills(seed: int, level: int) -> None:
    """Blending what differs by a unit, three quarters to one,
    is undone by rounding: the scan shows it, too.
    """
    image = holed(seed, 0.3, spread=4)
    spatial = SpatialFilter(magnitude=5.0, alpha=0.75, delta=1.0, holes_fill=float(level))
    result = units(spatial.apply(signal(image), 0.0, None)[0])
    np.testing.assert_array_equal(result, scan_spatial(image, 5, 0.75, 1, HOLE_RADIUS[level]))
    seen = image > 0
    np.testing.assert_array_equal(result[seen], image[seen])


def test_rows_that_see_nothing_but_at_their_end_are_filled_from_there() -> None:
    image = holed(3, 0.9, shape=(40, 6))
    spatial = SpatialFilter(magnitude=5.0, alpha=0.75, delta=1.0, holes_fill=2.0)
    assert np.any(np.all(image[:, :-1] == 0, axis=1) & (image[:, -1] > 0))
    np.testing.assert_array_equal(
        units(spatial.apply(signal(image), 0.0, None)[0]),
        scan_spatial(image, 5, 0.75, 1, HOLE_RADIUS[2]),
    )


@pytest.mark.parametrize(
    ("magnitude", "alpha", "delta"), [(1, 0.5, 20), (2, 0.5, 20), (5, 0.25, 8), (2, 0.75, 3)]
)
def test_spatial_smoothing_is_the_scan(magnitude: int, alpha: float, delta: int) -> None:
    image = holed(magnitude, 0.05, spread=40)
    spatial = SpatialFilter(magnitude=magnitude, alpha=alpha, delta=delta)
    result = units(spatial.apply(signal(image), 0.0, None)[0])
    np.testing.assert_array_equal(result, scan_spatial(image, magnitude, alpha, delta, 0))


@pytest.mark.parametrize(("alpha", "delta", "spread"), [(0.75, 1, 2), (0.4, 20, 60), (0.5, 3, 4)])
def test_temporal_filter_is_the_scan(alpha: float, delta: int, spread: int) -> None:
    temporal, scan = TemporalFilter(alpha=alpha, delta=delta), ScanTemporal(alpha, delta)
    state = temporal.init((), np.random.default_rng(0))
    rng = np.random.default_rng(1)
    filled = 0
    for k in range(12):
        image = 700 + rng.integers(0, spread, (10, 12))
        image[rng.random(image.shape) < 0.3] = 0
        result, state = temporal.apply(signal(image, 0.02 * k), 0.0, state)
        again, state = temporal.apply(signal(image, 0.02 * k), 0.0, state)
        np.testing.assert_array_equal(units(result), scan.step(image))
        np.testing.assert_array_equal(again.depth, result.depth)
        filled += int(np.sum((units(result) > 0) & (image == 0)))
    assert filled > 0


def test_smoothing_keeps_edges_and_quietens_surfaces() -> None:
    rng = np.random.default_rng(3)
    image = np.where(np.arange(60) < 30, 800, 1500) + rng.normal(0.0, 4.0, (40, 60)).round().astype(
        int
    )
    result = units(
        SpatialFilter(magnitude=2.0, alpha=0.5, delta=20.0).apply(signal(image), 0.0, None)[0]
    )
    for side in (slice(0, 30), slice(30, 60)):
        assert np.std(result[:, side]) < 0.5 * np.std(image[:, side])
        # Halves round up, at every blend
        assert abs(np.mean(result[:, side]) - np.mean(image[:, side])) < 5.0
