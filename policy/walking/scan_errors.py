"""Heights with the errors of the scan: held between images, late, wrong where unseen.

The error of a point lasts: it is a uniform number that changes at random, on average every
`ScanConfig.change_s`, times the spread of points that were seen, or of those that were not.
"""

import math

from saltus.arrays import Array, Constant, Points, Scalars, namespace
from saltus.grid import SCAN
from saltus.policy.walking.description import POLICY_HZ
from saltus.policy.walking.settings import ScanConfig

_WIDTH = math.sqrt(3.0)  # half width of a uniform law by its standard deviation


class ScanErrors:
    """The law of the errors, for numpy and torch."""

    def __init__(self, config: ScanConfig) -> None:
        self.config = config
        x, y = SCAN.points.T
        self._seen = Constant((x >= config.seen_x_m) & (abs(y) <= config.seen_y_m))

    def arrives(self, phase: Scalars) -> tuple[Scalars, Array]:
        """The camera's phase one policy step later, and who gets an image then; shape (n,)."""
        xp = namespace(phase)
        later = phase + self.config.image_hz / POLICY_HZ
        return later - xp.floor(later), later >= 1.0

    def changed(self, error: Points, fresh: Array, draws: Points) -> Points:
        """Numbers in [-1, 1] one policy step later: some of them, or all of who begins, are new.

        Args:
            error: Before it, shape (n, 187).
            fresh: Who begins, bool, shape (n,).
            draws: Uniform in [0, 1), shape (n, 187).
        """
        xp, share = namespace(error), 1.0 / (POLICY_HZ * self.config.change_s)
        all_new, some_new = 2.0 * draws - 1.0, 2.0 * draws / share - 1.0
        return xp.where(fresh[:, None], all_new, xp.where(draws < share, some_new, error))

    def observed(self, heights: Points, error: Points, shift: Scalars) -> Points:
        """Heights with errors [m], shape (n, 187).

        Args:
            heights: True ones relative to the base, at the place of the image [m], shape (n, 187).
            error: Of `changed`, shape (n, 187).
            shift: In [-1, 1], shape (n,).
        """
        xp, config = namespace(heights), self.config
        ground = xp.mean(heights, axis=-1)[:, None]
        spread = config.unseen * xp.mean(xp.abs(heights - ground), axis=-1)[:, None]
        is_seen = self._seen.like(heights) > 0.5
        one = xp.ones_like(heights)
        deviation = xp.where(is_seen, config.seen_m * one, xp.maximum(spread, config.seen_m * one))
        return heights + _WIDTH * deviation * error + config.shift_m * shift[:, None]
