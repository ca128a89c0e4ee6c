"""By how much the odometry has drifted since the map was made: new heights against remembered ones.

A pose that is off by (ex, ey, ez) puts new points where the map is m(x - ex, y - ey) + ez, so that a new height differs
from the map's by r = -gx ex - gy ey + ez with the map's slopes g. Weighted least squares over all cells that both know,
with what the odometry can have drifted since the last image as prior, give the three.
"""

from saltus.arrays import Array, namespace
from saltus.heightmap.scan.cells import CellHeights
from saltus.heightmap.scan.settings import MapSettings

STEEPEST = 3.0
"""A slope that is measured over two cells of 2 cm is taken to be no more: at a vertical face any number would do."""


def drift(height: Array, variance: Array, known: Array, new: CellHeights, settings: MapSettings) -> Array:
    """Error of the pose [m] at which `new` was measured, in x, y and z. Shape (batch, 3)."""
    xp = namespace(height)
    residual = new.mean - height
    used = known & (new.count > 0.0) & (xp.abs(residual) < settings.gate_m)
    weight = xp.where(used, settings.independent / (variance + new.variance + settings.least_m**2), 0.0)
    factors = [-slope for slope in _slopes(height, known, settings.fine_m)]
    factors.append(xp.ones_like(residual))
    normal = [[xp.sum(weight * a * b, axis=(1, 2)) for b in factors] for a in factors]
    prior = xp.eye(3, dtype=height.dtype, device=height.device) / settings.step_m**2
    matrix = xp.stack([xp.stack(row, -1) for row in normal], -2) + prior[None]
    right = xp.stack([xp.sum(weight * factor * residual, axis=(1, 2)) for factor in factors], -1)
    return _solved(matrix, right)


def _solved(matrix: Array, right: Array) -> Array:
    """Cramer's rule for symmetric matrices (batch, 3, 3): no call that a GPU would have to wait for."""
    xp = namespace(matrix)
    a, b, c = matrix[:, 0], matrix[:, 1], matrix[:, 2]
    crossed = xp.stack([xp.linalg.cross(b, c), xp.linalg.cross(c, a), xp.linalg.cross(a, b)], axis=1)
    determinant = xp.sum(a * crossed[:, 0], axis=-1)
    return xp.sum(crossed * right[:, None, :], axis=-1) / determinant[:, None]


def _slopes(height: Array, known: Array, fine_m: float) -> tuple[Array, Array]:
    """Along x and y, 0 where a neighbour is unknown or the window ends."""
    xp = namespace(height)

    def along(values: Array, mask: Array) -> Array:
        both = mask[:, 2:, :] & mask[:, :-2, :]
        inner = xp.where(both, (values[:, 2:, :] - values[:, :-2, :]) / (2.0 * fine_m), 0.0)
        edge = xp.zeros_like(values[:, :1, :])
        return xp.clip(xp.concat([edge, inner, edge], axis=1), -STEEPEST, STEEPEST)

    turned = along(xp.matrix_transpose(height), xp.matrix_transpose(known))
    return along(height, known), xp.matrix_transpose(turned)
