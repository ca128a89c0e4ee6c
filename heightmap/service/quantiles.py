"""Errors as the network states them: an interval of 90 %,
and the law by which other intervals follow from it.
"""

import math

import numpy as np

from saltus.arrays import Floats
from saltus.constants import NORMAL_90

INTERVAL90 = NORMAL_90
"""Half of the 90 % interval over what a model file calls `std`. For normal errors that would be
their standard deviation; real errors have heavier tails, and the network is fitted to hold 90 % of
them, so it is not."""
UNKNOWN_HALF_WIDTH_M = INTERVAL90 * 0.5
"""Half-width of a height that nobody has seen: the deepest trench."""
_SCALE = 1.0 / math.log(10.0)
"""Scale of the Laplace law over half of its 90 % interval. Its tails are nearer to those of the
errors than those of a normal law."""


def half_width(level: float) -> float:
    """Half of the interval that holds a share `level` of a Laplace law,
    over half of the one that holds 90 %.
    """
    return -math.log(1.0 - level) * _SCALE


def negative_log_likelihood(error: Floats, half_width_90: Floats) -> Floats:
    """Negative log likelihood of errors under the Laplace law
    with that half of the 90 % interval [m], in nats.
    """
    scale = _SCALE * np.asarray(half_width_90)
    return np.abs(error) / scale + np.log(2.0 * scale)
