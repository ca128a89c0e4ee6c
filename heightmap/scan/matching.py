"""By how much the odometry has drifted since the map was made: new heights against remembered ones.

A pose that is off by (ex, ey, ez) and tilted by (rx, ry) puts new points, at (x, y) from the base,
where the map is m(x - ex, y - ey) + ez + rx y - ry x, so that a new height differs from the map's
by r = -gx ex - gy ey + ez + rx y - ry x with the map's slopes g. Weighted least squares over all
cells that both know, with what the odometry can have drifted since the last image as prior, give
the five.
"""

from typing import NamedTuple

import numpy as np

from saltus.arrays import Array, namespace
from saltus.heightmap.scan.cells import CellHeights
from saltus.heightmap.scan.settings import MapSettings

STEEPEST = 3.0
"""A slope that is measured over two cells of 2 cm is taken to be no more: at a vertical face any
number would do."""


class PoseError(NamedTuple):
    """Error of the pose at which an image was taken, as matching it with the map finds it."""

    shift: Array
    """Error of the position [m], which stays until it is corrected. Shape (batch, 3)."""
    tilt: Array
    """About x and y of the odometry's world [rad], which swings and is of this image alone.
    Shape (batch, 2)."""


def match_drift(
    height: Array, variance: Array, known: Array, slopes: tuple[Array, Array], new: CellHeights,
    away: tuple[Array, Array], settings: MapSettings,
) -> PoseError:  # fmt: skip
    """Compares `new` with the map and its `slopes_of`;
    `away` are x and y of the cells from the base [m].
    """
    xp, batch = namespace(height), len(height)
    residual = new.mean - height
    steepness = slopes[0] ** 2 + slopes[1] ** 2
    used = known & (new.count > 0.0) & (xp.abs(residual) < settings.gate_m)
    used = used & (steepness <= settings.matched_slope**2)
    one = xp.ones_like(residual)
    columns = [*slopes, away[0] * one, away[1] * one, residual, steepness, variance + new.variance]
    used, *columns = (column.reshape(batch, -1) for column in (used, *columns))
    if alone := isinstance(used, np.ndarray) and batch == 1:  # an image hits one cell in eight
        cells = np.flatnonzero(used)
        used, *columns = (column.take(cells, axis=1) for column in (used, *columns))
    slope_x, slope_y, x, y, residual, steepness, noise = columns
    # A point may be off sideways, too: by so much it says less of the height the steeper the map
    # is.
    total = noise + settings.sideways_m**2 * steepness + settings.least_m**2
    weight = xp.where(used, settings.independent / total, 0.0)
    factors = xp.stack([-slope_x, -slope_y, xp.ones_like(x), y, -x, residual], axis=1)
    products = (factors[:, :-1] * weight[:, None]) @ xp.matrix_transpose(factors)
    # Numpy's numbers take a third of the time of arrays of one
    numbers = products[0] if alone else xp.permute_dims(products, (1, 2, 0))
    priors = [settings.step_m] * 3 + [settings.tilt_rad] * 2
    matrix = [
        [numbers[i, j] + (i == j) * prior**-2 for j in range(i + 1)]
        for i, prior in enumerate(priors)
    ]
    found = _solved(matrix, [numbers[i, -1] for i in range(len(priors))])
    shift, tilt = (xp.stack(part, axis=-1) for part in (found[:3], found[3:]))
    return PoseError(xp.reshape(shift, (batch, 3)), xp.reshape(tilt, (batch, 2)))


def _solved(lower: list[list[Array]], right: list[Array]) -> list[Array]:
    """Solves symmetric positive systems by their factors L D L',
    written out: a GPU need not be waited for.
    """
    n = len(right)
    factor: list[list[Array]] = [[None] * n for _ in range(n)]
    diagonal: list[Array] = []
    forward: list[Array] = []
    for i in range(n):
        for j in range(i):
            shared = sum(factor[i][k] * diagonal[k] * factor[j][k] for k in range(j))
            factor[i][j] = (lower[i][j] - shared) / diagonal[j]
        diagonal.append(lower[i][i] - sum(factor[i][k] ** 2 * diagonal[k] for k in range(i)))
        forward.append(right[i] - sum(factor[i][k] * forward[k] for k in range(i)))
    found: list[Array] = [None] * n
    for i in reversed(range(n)):
        found[i] = forward[i] / diagonal[i] - sum(factor[k][i] * found[k] for k in range(i + 1, n))
    return found


def slopes_of(height: Array, known: Array, fine_m: float) -> tuple[Array, Array]:
    """Slopes along x and y, 0 where a neighbour is unknown or the window ends."""
    xp = namespace(height)

    def along(axis: int) -> Array:
        ahead, behind, first = (
            (slice(None),) * axis + (part,) for part in (slice(2, None), slice(-2), slice(1))
        )
        steep = (height[ahead] - height[behind]) / (2.0 * fine_m)
        inner = (known[ahead] & known[behind]) * steep
        edge = xp.zeros_like(height[first])
        return xp.concat([edge, inner, edge], axis=axis).clip(-STEEPEST, STEEPEST)

    return along(1), along(2)
