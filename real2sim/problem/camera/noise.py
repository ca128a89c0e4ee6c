"""Noise of measured depth by range, from second differences along rows,
which no smooth error of geometry survives.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.special import ndtri

from saltus.arrays import Floats, Indices

BINS = 10
FEWEST = 40  # second differences in a bin: their spread is then known to a tenth
OUTLIER = 5.0  # spreads of a bin; mixed pixels at edges are beyond
LEAST_M = 1e-3 / math.sqrt(12.0)  # rounding to a run log's unit of depth
# Median absolute deviation of a normal distribution of unit variance
NORMAL_DEVIATION = float(ndtri(0.75))
SECOND_DIFFERENCE = 6.0  # 1 + 4 + 1: variance of x[-1] - 2 x[0] + x[1] over that of white x


@dataclass(frozen=True, kw_only=True)
class NoiseLaw:
    """How a camera's noise grows with depth z: standard deviation sqrt((quadratic z^2)^2 +
    constant^2) of one pixel.
    """

    quadratic: float
    """[1/m]."""
    constant: float
    """[m]."""

    def sigma(self, depth: Floats) -> Floats:
        """[m], shape as `depth` [m]."""
        return np.sqrt((self.quadratic * depth**2) ** 2 + self.constant**2)


def second_differences(values: Floats) -> Floats:
    """Second differences along the last axis but one, white noise keeps its size;
    (frames, rows, columns - 2).
    """
    bend = values[..., 2:] - 2.0 * values[..., 1:-1] + values[..., :-2]
    return bend / np.sqrt(SECOND_DIFFERENCE)


def fitted_noise(depth: Floats, difference: Floats) -> NoiseLaw:
    """Fits the noise to second differences of measured less predicted depth [m], NaN where missing.

    `depth` is predicted, at the middle of each difference [m].
    """
    known = np.isfinite(difference) & np.isfinite(depth)
    z, d = depth[known], difference[known]
    if z.size < FEWEST:
        return NoiseLaw(quadratic=1.3e-3, constant=LEAST_M)
    order = np.argsort(z)
    parts = np.array_split(order, min(BINS, max(1, z.size // FEWEST)))
    range_m = np.array([np.median(z[part]) for part in parts])
    variance = np.array([_variance(d[part], z[part])[0] for part in parts])
    design = np.stack([range_m**4, np.ones_like(range_m)], axis=1) / variance[:, None]
    (quadratic, constant), _ = nnls(design, 1.0 - LEAST_M**2 / variance)
    return NoiseLaw(
        quadratic=float(np.sqrt(quadratic)), constant=float(np.sqrt(constant + LEAST_M**2))
    )


def log_variance(difference: Floats, depth: Floats) -> tuple[float, float]:
    """Logarithm of the variance of second differences [m],
    outliers cut, and its standard deviation; shapes (n,).
    """
    variance, count = _variance(difference, depth)
    # neighbouring differences share two of three samples: about half of them are worth one
    # independent each
    return float(np.log(variance)), float(np.sqrt(4.0 / max(count, 2)))


def log_repeating(difference: Floats, depth: Floats, group: Indices, block: Indices) -> float:
    """Logarithm of the variance of differences [m] over that of what does not repeat,
    0 where nothing does.

    The mean product of two differences of one group is what repeats in it. Pairs of one block of
    the group, or of neighbouring blocks, do not count, as noise that lasts for a while or covers a
    few pixels makes them alike. `group` and `block` count from 0; shapes (n,).
    """
    variance, _ = _variance(difference, depth)
    kept = np.clip(difference, -OUTLIER * np.sqrt(variance), OUTLIER * np.sqrt(variance))
    blocks = int(block.max()) + 1
    place, size = group * blocks + block, (int(group.max()) + 1) * blocks
    sums, counts = (
        np.bincount(place, weights, size).reshape(-1, blocks)
        for weights in (kept, np.ones_like(kept))
    )
    apart = np.abs(np.subtract.outer(np.arange(blocks), np.arange(blocks))) > 1
    products, pairs = (
        np.einsum("gb,bc,gc->", each, apart.astype(float), each) for each in (sums, counts)
    )
    if pairs < FEWEST**2:
        return 0.0
    # rounding of a scene that stands still repeats, too
    repeating = max(float(products / pairs) - LEAST_M**2, 0.0)
    return float(np.log(variance / max(variance - repeating, LEAST_M**2)))


def _variance(difference: Floats, depth: Floats) -> tuple[float, int]:
    """Variance without outliers [m^2], at least that of rounding, and of how many."""
    relative = difference / depth**2  # far pixels are noisier: that makes no outlier
    # by hand: `scipy.stats` takes ten times as long, most of it to look at its arguments
    deviation = np.median(np.abs(relative - np.median(relative)))
    spread = deviation / NORMAL_DEVIATION * depth**2
    # Rounding may leave mostly zeros
    kept = difference[np.abs(difference) < OUTLIER * np.maximum(spread, LEAST_M)]
    return max(float(np.mean(kept**2)), LEAST_M**2), len(kept)
