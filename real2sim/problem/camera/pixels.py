"""Which pixels of depth images are compared, and which lie too near to an edge."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from saltus.arrays import Floats, Indices

ROWS, COLUMNS = 14, 18  # 252 pixels: floor and wall need a handful each; the rest averages noise
MARGIN = 0.03  # of the image's width: how far an edge may move by what is searched for
LEAST_MARGIN = 2  # px: a camera mixes the pixels at an edge
BEND = 0.04  # of the disparity: less is what a crease between two planes makes within the margin
BELOW_MM = 10  # below an end of the range, in which depths are as usual
PILE = (
    3.0  # times as many pixels at the end: it then takes away 3 mm of the scene, and not only noise
)
FEWEST_AT_END = 30  # pixels


@dataclass(frozen=True, kw_only=True, eq=False)
class PixelGrid:
    """Evenly spaced pixels of an image, row by row, away from its border."""

    row: Indices
    """Shape (pixels,)."""
    column: Indices
    columns: int
    """Pixels in a row of the grid."""
    margin: int
    """Distance [px] within which a pixel feels an edge."""

    @classmethod
    def of(cls, height: int, width: int) -> "PixelGrid":
        """A grid in images of that size."""
        margin = max(LEAST_MARGIN, round(MARGIN * width))
        row, column = (
            np.unique(
                np.linspace(
                    margin, size - 1 - margin, min(count, max(1, size - 2 * margin))
                ).round()
            )
            for size, count in ((height, ROWS), (width, COLUMNS))
        )
        grid = np.meshgrid(row.astype(np.int64), column.astype(np.int64), indexing="ij")
        return cls(row=grid[0].ravel(), column=grid[1].ravel(), columns=len(column), margin=margin)

    def shifted(self, rows: int, columns: int) -> "PixelGrid":
        """The grid moved by whole pixels."""
        return PixelGrid(
            row=self.row + rows,
            column=self.column + columns,
            columns=self.columns,
            margin=self.margin,
        )

    def around(self) -> tuple[tuple["PixelGrid", "PixelGrid"], ...]:
        """Pairs of grids on opposite sides of each pixel,
        near and at the margin, along rows and columns.
        """
        steps = [(0, s) for s in range(1, self.margin + 1)] + [
            (s, 0) for s in range(1, self.margin + 1)
        ]
        return tuple((self.shifted(-r, -c), self.shifted(r, c)) for r, c in steps)

    def of_images(self, images: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Values at the pixels, shape (images, pixels)."""
        return images[:, self.row, self.column]

    def distance_to_others(self, chosen: NDArray[np.bool_]) -> Floats:
        """Distance of chosen pixels to the nearest of the grid that is not [px],
        shape (images, pixels).
        """
        images = chosen.reshape(len(chosen), -1, self.columns)
        rows, columns = images.shape[1:]
        steps = (
            float(np.ptp(self.row)) / max(1, rows - 1),
            float(np.ptp(self.column)) / max(1, columns - 1),
        )
        apart = np.array([distance_transform_edt(image, steps) for image in images])
        # Nothing to be near to
        apart[images.all(axis=(1, 2))] = np.hypot(np.ptp(self.row), np.ptp(self.column))
        return apart.reshape(chosen.shape)

    def as_image(self, values: Floats) -> Floats:
        """Values of pixels in rows and columns, shape (..., rows, columns)."""
        return values.reshape(*values.shape[:-1], -1, self.columns)


def is_broken(depth: Floats, before: Floats, after: Floats, sigma: Floats) -> NDArray[np.bool_]:
    """True where depth [m] jumps between two opposite neighbours of pixels.

    Disparity is linear over a plane.

    0 or infinite is no depth, and says nothing in a neighbour. `sigma` is the noise of `depth` [m].
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        bend = np.abs(1.0 / before + 1.0 / after - 2.0 / depth) * depth
        return np.asarray(np.isfinite(bend) & (bend > np.maximum(BEND, 8.0 * sigma / depth)))


def clip_guess(images_mm: NDArray[np.uint16], range_m: float) -> float | None:
    """Where measured depth ends short of the claimed range [m]; None where it does not.

    What is farther reads as the end itself: far more pixels have the largest depth than have any
    just below it.
    """
    counts = np.bincount(images_mm.ravel(), minlength=BELOW_MM + 2)
    counts[0] = 0
    end = int(np.flatnonzero(counts)[-1]) if counts.any() else 0
    below = counts[max(end - BELOW_MM, 1) : end]
    if counts[end] < FEWEST_AT_END or counts[end] < PILE * np.max(below, initial=0):
        return None
    return 1e-3 * end if 1e-3 * end < range_m - 1e-3 else None
