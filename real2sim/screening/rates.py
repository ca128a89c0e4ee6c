"""Mean rates between two rows, to be compared with the change of what they are the rate of."""

import numpy as np

from saltus.arrays import Floats


def means(values: Floats, rows: int) -> Floats:
    """Means over so many steps from each row on, ends with half their weight; (n, columns) -> (n - rows, columns)."""
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(0.5 * (values[1:] + values[:-1]), axis=0)])
    return np.asarray((total[rows:] - total[:-rows]) / rows)
