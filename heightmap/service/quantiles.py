"""What a stated standard deviation of a height means: an interval of 90 %, and the law of the others."""

import math

import numpy as np

from saltus.arrays import Floats

INTERVAL90 = 1.645
"""So many of them to each side hold 90 % of the errors: by this they are fitted. For normal errors it is the usual
standard deviation; real errors have heavier tails, so it is not the root of their mean square."""
_SCALE = INTERVAL90 / math.log(10.0)
"""Scale of the Laplace law whose 90 % interval this is, over the standard deviation. Its tails are nearer to those of
the errors than those of a normal law."""


def half_width(level: float) -> float:
    """Standard deviations to each side that hold a share `level` of a Laplace law."""
    return -math.log(1.0 - level) * _SCALE


def negative_log_likelihood(error: Floats, std: Floats) -> Floats:
    """Of errors [m] under the Laplace law, in nats."""
    scale = _SCALE * np.asarray(std)
    return np.abs(error) / scale + np.log(2.0 * scale)
