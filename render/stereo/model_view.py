"""The fast way to what the model sees: a few rays for each
of its pixels instead of the 25 of the sensor.
"""

from saltus.arrays import Array, Images, namespace
from saltus.depth import VALID_SHARE

ROWS, COLUMNS = 3, 1
"""Rays for a pixel of the model in training: depth edges are horizontal in most of what a robot
sees ahead."""


def pool_valid(depth: Images, rows: int, columns: int) -> Array:
    """Averages the valid samples of each pixel of the model.

    Args:
        depth: [m], 0 where invalid, shape (..., 48 rows, 16 columns).
        rows: samples for each pixel.
        columns: samples for each pixel.

    Returns:
        Depth [m], 0 where fewer than half of the samples are valid, shape (..., 48, 16); see
        `saltus.depth.model_image`.
    """
    xp = namespace(depth)
    total = _block_sums(depth, rows, columns)
    count = _block_sums(xp.astype(depth > 0.0, xp.uint8), rows, columns)
    seen = count >= VALID_SHARE * rows * columns
    return xp.where(seen, total, xp.zeros_like(total)) / xp.astype(
        xp.where(seen, count, count + 1), depth.dtype
    )


def _block_sums(values: Array, rows: int, columns: int) -> Array:
    """Sums of blocks of `rows` times `columns` samples,
    shape (..., height / rows, width / columns).
    """
    total = values[..., ::rows, :]
    for i in range(1, rows):
        total = total + values[..., i::rows, :]
    result = total[..., ::columns]
    for i in range(1, columns):
        result = result + total[..., i::columns]
    return result
