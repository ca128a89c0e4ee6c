"""Heights with the errors of the scan: held between images, late, wrong where unseen.

The error of a point lasts: it is a uniform number, times the spread of points that were seen, or
of those that were not. It changes at random where the robot has moved, on average every
`ScanErrorSettings.change_m`: who stands goes on seeing what it saw. Most gaps that are one spacing
of the scan wide are told as if they were filled.
"""

import math

from saltus.arrays import Array, Constant, Points, Scalars, namespace
from saltus.grid import SCAN
from saltus.policy.walking.course_field import MISSED_M
from saltus.policy.walking.description import POLICY_HZ
from saltus.policy.walking.settings import ScanErrorSettings

_WIDTH = math.sqrt(3.0)  # half width of a uniform law by its standard deviation
_STEP_M = 0.05  # way after which some errors change, half the scan's spacing: swaying is no way
_LEVER_M = 0.54  # mean distance of the scan's points: their way where it turns by 1 rad


class ScanErrors:
    """Draws the errors of the scan that walking robots are trained with, for numpy and torch."""

    def __init__(self, config: ScanErrorSettings) -> None:
        self.config = config
        x, y = SCAN.points.T
        self._seen = Constant((x >= config.seen_x_m) & (abs(y) <= config.seen_y_m))

    def arrives(self, phase: Scalars) -> tuple[Scalars, Array]:
        """The camera's phase one policy step later, and who gets an image then; shape (n,)."""
        xp = namespace(phase)
        later = phase + self.config.image_hz / POLICY_HZ
        return later - xp.floor(later), later >= 1.0

    def moved(self, pose: Array, before: Array) -> Array:
        """Robots that have moved since their errors changed, bool, shape (n,).

        Args:
            pose: x, y, z, yaw of the bases [m, rad], shape (n, 4).
            before: The same when they changed.
        """
        way = pose - before
        square = way[:, 0] ** 2 + way[:, 1] ** 2 + (_LEVER_M * way[:, 3]) ** 2
        return square > _STEP_M**2

    def changed(self, error: Points, fresh: Array, moved: Array, draws: Points) -> Points:
        """Numbers in [-1, 1] one policy step later: some of who has moved,
        and all of who begins, are new.

        Args:
            error: Before it, shape (n, 187).
            fresh: Who begins, bool, shape (n,).
            moved: Of `moved`, bool, shape (n,).
            draws: Uniform in [0, 1), shape (n, 187).
        """
        xp, share = namespace(error), min(1.0, _STEP_M / self.config.change_m)
        all_new, some_new = 2.0 * draws - 1.0, 2.0 * draws / share - 1.0
        new = moved[:, None] & (draws < share)
        return xp.where(fresh[:, None], all_new, xp.where(new, some_new, error))

    def observed(self, heights: Points, error: Points, shift: Scalars) -> Points:
        """Heights with errors [m], shape (n, 187).

        Args:
            heights: True ones relative to the base, at the place of the image [m], shape (n, 187).
            error: Of `changed`, shape (n, 187).
            shift: In [-1, 1], shape (n,).
        """
        xp, config = namespace(heights), self.config
        heights = xp.where(xp.abs(error) < config.filled, _without_gaps(heights), heights)
        ground = xp.mean(heights, axis=-1)[:, None]
        spread = config.unseen * xp.mean(xp.abs(heights - ground), axis=-1)[:, None]
        is_seen = self._seen.like(heights) > 0.5
        one = xp.ones_like(heights)
        deviation = xp.where(is_seen, config.seen_m * one, xp.maximum(spread, config.seen_m * one))
        return heights + _WIDTH * deviation * error + config.shift_m * shift[:, None]


def _without_gaps(heights: Points) -> Points:
    """Heights where points low between both neighbours along x, or along y, are as high as these.

    Low is `MISSED_M` lower than the lower neighbour, as for a foot that misses its ground. Points
    at the rim of the scan are left as they are.
    """
    xp = namespace(heights)
    of = xp.reshape(heights, (-1, *SCAN.shape))
    along_x = xp.minimum(of[:, :-2, 1:-1], of[:, 2:, 1:-1])
    along_y = xp.minimum(of[:, 1:-1, :-2], of[:, 1:-1, 2:])
    edge, inner = xp.maximum(along_x, along_y), of[:, 1:-1, 1:-1]
    inner = xp.where(inner < edge - MISSED_M, edge, inner)
    rows = xp.concat([of[:, 1:-1, :1], inner, of[:, 1:-1, -1:]], axis=2)
    return xp.reshape(xp.concat([of[:, :1], rows, of[:, -1:]], axis=1), heights.shape)
