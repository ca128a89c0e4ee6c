"""Heights where nothing is known: from what is known around,
coarser the farther it is (pull, then push).
"""

from saltus.arrays import Array, namespace


def fill_cells(height: Array, weight: Array) -> Array:
    """`height` (batch, side, side) where `weight` is 1,
    a mean of what is around where it is 0, mixed in between.

    `side` is a power of two times a small number. Where nothing has weight, the height is 0.
    """
    xp = namespace(height)
    side = height.shape[1]
    if side % 2 or side <= 2:
        total = xp.sum(weight, axis=(1, 2), keepdims=True)
        mean = xp.sum(weight * height, axis=(1, 2), keepdims=True) / (total + _LEAST)
        return weight * height + (1.0 - weight) * mean
    weighted, total = weight * height, _fours(weight)
    coarse = fill_cells(_fours(weighted) / (total + _LEAST), total.clip(0.0, 1.0))
    return weighted + (1.0 - weight) * _doubled(coarse)


_LEAST = 1e-9


def _fours(values: Array) -> Array:
    """Sums of two by two."""
    rows = values[:, 0::2, :] + values[:, 1::2, :]
    return rows[:, :, 0::2] + rows[:, :, 1::2]


def _doubled(values: Array) -> Array:
    """Bilinear on twice as many rows and columns, held at the border."""
    rows = _doubled_rows(values)
    return namespace(values).matrix_transpose(
        _doubled_rows(namespace(values).matrix_transpose(rows))
    )


def _doubled_rows(values: Array) -> Array:
    xp = namespace(values)
    near = 0.75 * values
    far = 0.25 * xp.concat([values[:, :1], values, values[:, -1:]], axis=1)
    pair = xp.concat([(near + far[:, :-2])[:, :, None], (near + far[:, 2:])[:, :, None]], axis=2)
    return xp.reshape(pair, (values.shape[0], 2 * values.shape[1], values.shape[2]))
