"""Mean rates between two rows, for comparison with the change of the integrated quantity."""

import numpy as np

from saltus.arrays import Floats


def means(values: Floats, rows: int) -> Floats:
    """Means over `rows` steps, the ends with half weight; shapes (n, columns) -> (n - rows, columns)."""
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(0.5 * (values[1:] + values[:-1]), axis=0)])
    return np.asarray((total[rows:] - total[:-rows]) / rows)
