"""Spread of the noise in parts of a log: by segment and range."""

import itertools
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.real2sim.problem.camera.log_images import CameraData
from saltus.real2sim.problem.camera.noise import log_repeating, log_variance, second_differences
from saltus.real2sim.problem.camera.pixels import PixelGrid

RANGES = 4  # parts of the range in which noise is told apart: it grows with the square
FEWEST_DIFFERENCES = 60
AGES = 5  # parts of a segment's time: each longer than a temporal filter remembers


@dataclass(frozen=True, kw_only=True, eq=False)
class NoiseParts:
    """Second differences along rows, in parts.

    What a wrong prediction leaves at the ghost of an edge, as a temporal filter makes them, is no
    noise: the spread is that beside whatever is predicted.
    """

    grid: PixelGrid
    measured: Floats
    """At the grid [m], shape (kept, pixels)."""
    at: tuple[Indices, ...]
    """Places of each part's differences in all of them."""
    depth: tuple[Floats, ...]
    """Their depth without effects [m]."""
    segment: Indices
    """Segment of each part, shape (parts,)."""
    deviation: Floats
    """Standard deviation of the logarithm of the variance by chance, shape (parts,)."""
    range4: Floats
    """Mean fourth power of depth [m^4], shape (parts,)."""
    age: tuple[Indices, ...]
    """Part of its segment's time in which each difference is, from 0 to `AGES`."""

    def log_variances(self, predicted: Floats) -> Floats:
        """Logarithm of the variance [m^2] in each part beside predicted depth [m]
        of shape (kept, pixels).
        """
        difference = self._differences(predicted)
        return np.array(
            [log_variance(difference[at], z)[0] for at, z in zip(self.at, self.depth, strict=True)]
        )

    def log_repeating(self, predicted: Floats) -> Floats:
        """Logarithm of what repeating structure adds to the variance in each part, shape (parts,).

        It stays in a pixel from image to image, or the pixels of a column of one image share it.
        """
        difference = self._differences(predicted)
        rows, columns = self.grid.as_image(self.measured[:1])[0, :, 2:].shape
        found = []
        for at, z, age in zip(self.at, self.depth, self.age, strict=True):
            image, pixel = np.divmod(at, rows * columns)
            row, column = np.divmod(pixel, columns)
            shown = (image - image.min()) * columns + column
            found.append(
                max(log_repeating(difference[at], z, *by) for by in ((pixel, age), (shown, row)))
            )
        return np.array(found)

    def _differences(self, predicted: Floats) -> Floats:
        return second_differences(self.grid.as_image(self.measured - predicted)).ravel()

    def means(self, values: Floats) -> Floats:
        """Means over each part of values at the grid, shape (kept, pixels)."""
        middle = self.grid.as_image(values)[..., 1:-1].ravel()
        return np.array([np.mean(middle[at]) for at in self.at])


def noise_parts(data: CameraData) -> NoiseParts:
    """The parts of a log that have enough differences."""
    depth = data.grid.as_image(data.predicted)[..., 1:-1].ravel()
    known = np.isfinite(data.difference).ravel()
    owner = np.repeat(data.owner, data.difference[0].size)
    limits = (
        np.quantile(depth[known], np.linspace(0.0, 1.0, RANGES + 1)).tolist() if known.any() else []
    )
    found = []
    for k in np.unique(data.owner):
        for low, high in itertools.pairwise(limits):
            at = np.flatnonzero(known & (owner == k) & (depth >= low) & (depth <= high))
            if len(at) >= FEWEST_DIFFERENCES:
                found.append((int(k), at, log_variance(data.difference.ravel()[at], depth[at])[1]))
    parts = [at for _, at, _ in found]
    age = np.zeros(len(data.owner), dtype=np.int64)
    for k in np.unique(data.owner):
        age[data.owner == k] = np.linspace(0.0, AGES - 1e-9, int(np.sum(data.owner == k))).astype(
            np.int64
        )
    return NoiseParts(
        grid=data.grid,
        measured=data.measured,
        at=tuple(parts),
        depth=tuple(depth[at] for at in parts),
        segment=np.array([k for k, _, _ in found], dtype=np.int64),
        deviation=np.array([deviation for _, _, deviation in found]),
        range4=np.array([np.mean(depth[at] ** 4) for at in parts]),
        age=tuple(age[at // data.difference[0].size] for at in parts),
    )
