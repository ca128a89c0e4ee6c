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
    xp = namespace(height)
    residual = new.mean - height
    steepness = slopes[0] ** 2 + slopes[1] ** 2
    used = known & (new.count > 0.0) & (xp.abs(residual) < settings.gate_m)
    used = used & (steepness <= settings.matched_slope**2)
    # A point may be off sideways, too: by so much it says less of the height the steeper the map
    # is.
    steep = settings.sideways_m**2 * steepness
    total = variance + new.variance + steep + settings.least_m**2
    weight = xp.where(used, settings.independent / total, 0.0)
    batch, one = len(height), xp.ones_like(residual)
    columns = [-slopes[0], -slopes[1], one, away[1] * one, -away[0] * one, residual]
    if isinstance(weight, np.ndarray) and batch == 1:  # an image hits one cell in eight
        cells = np.flatnonzero(weight)
        factors = np.stack([column.reshape(-1)[cells] for column in columns])[None]
        weight = weight.reshape(-1)[cells]
    else:
        factors = xp.reshape(xp.stack(columns, axis=1), (batch, len(columns), -1))
    products = (factors[:, :-1] * xp.reshape(weight, (batch, 1, -1))) @ xp.matrix_transpose(factors)
    priors = [settings.step_m] * 3 + [settings.tilt_rad] * 2
    matrix = [
        [products[:, i, j] + (i == j) * prior**-2 for j in range(i + 1)]
        for i, prior in enumerate(priors)
    ]
    found = _solved(matrix, [products[:, i, -1] for i in range(len(priors))])
    return PoseError(xp.stack(found[:3], axis=-1), xp.stack(found[3:], axis=-1))


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

    def along(values: Array, mask: Array) -> Array:
        both = mask[:, 2:, :] & mask[:, :-2, :]
        inner = xp.where(both, (values[:, 2:, :] - values[:, :-2, :]) / (2.0 * fine_m), 0.0)
        edge = xp.zeros_like(values[:, :1, :])
        return xp.concat([edge, inner, edge], axis=1).clip(-STEEPEST, STEEPEST)

    turned = along(xp.matrix_transpose(height), xp.matrix_transpose(known))
    return along(height, known), xp.matrix_transpose(turned)
