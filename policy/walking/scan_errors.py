"""Heights with the errors of the scan: held between images, late, wrong where unseen.

The error of a point lasts: it is a uniform number, times the spread of points that were seen, or
of those that were not, times the noise of the episode. It changes at random where the robot has
moved, on average every `ScanErrorSettings.change_m`: who stands goes on seeing what it saw. Gaps
across the way that are one spacing of the scan wide are told as dips of any depth.
"""

import math
from typing import NamedTuple

from saltus.arrays import Array, Constant, Points, Scalars, namespace
from saltus.grid import SCAN
from saltus.policy.walking.course_field import MISSED_M
from saltus.policy.walking.description import POLICY_HZ
from saltus.policy.walking.settings import ScanErrorSettings

_WIDTH = math.sqrt(3.0)  # half width of a uniform law by its standard deviation
_STEP_M = 0.05  # way after which some errors change, half the scan's spacing: swaying is no way
_LEVER_M = 0.54  # mean distance of the scan's points: their way where it turns by 1 rad
_CELL_M = 0.1, 0.3  # sides of the world's cells along x and y, with one dip each: dips one, two and
# three spacings apart along y then have correlations of 0.67, 0.33, 0; 0.54, 0.33, 0 were measured
_DEPTH_M = 0.65  # the deepest dip, told no deeper than the gap is: 0.4 m where dips were measured
_POWER = 2.2  # of a uniform number: 72 % are deeper than 4 cm, 54 % than 12, as in docs/walking.md
_WAVE = (12.9898, 78.233, 43758.5453)  # the hash of many a shader: sines of these look random


class ScanDraws(NamedTuple):
    """Numbers of each robot's episode, each of shape (n,)."""

    shift: Scalars
    """In [-1, 1]: how far up all heights are told."""
    noise: Scalars
    """In [0, 1]: its square is the size of all errors of points."""


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

    def observed(
        self, heights: Points, places: tuple[Array, Array], error: Points, drawn: ScanDraws
    ) -> Points:
        """Heights with errors [m], shape (n, 187).

        Args:
            heights: True ones relative to the base, at the place of the image [m], shape (n, 187).
            places: Where these are in the world, x and y [m], each of shape (n, 187).
            error: Of `changed`, shape (n, 187).
            drawn: For the episode.
        """
        xp, config = namespace(heights), self.config
        above = xp.clip(_random_of(places, drawn.shift) - config.filled, 0.0, None)
        heights = _with_dips(heights, _DEPTH_M * (above / max(1.0 - config.filled, 1e-6)) ** _POWER)
        ground = xp.mean(heights, axis=-1)[:, None]
        spread = config.unseen * xp.mean(xp.abs(heights - ground), axis=-1)[:, None]
        is_seen = self._seen.like(heights) > 0.5
        one = xp.ones_like(heights)
        deviation = xp.where(is_seen, config.seen_m * one, xp.maximum(spread, config.seen_m * one))
        noise = (drawn.noise**2)[:, None]
        return heights + _WIDTH * noise * deviation * error + config.shift_m * drawn.shift[:, None]


def _random_of(places: tuple[Array, Array], seed: Scalars) -> Points:
    """A number in [0, 1) of the cell of the world in which each place is, another one for each
    seed: dips stay where they are while a robot comes to them.
    """
    xp = namespace(seed)
    x, y = (xp.floor(place / side) for place, side in zip(places, _CELL_M, strict=True))
    wave = _WAVE[2] * xp.sin(_WAVE[0] * x + _WAVE[1] * y + 1e2 * seed[:, None])
    return wave - xp.floor(wave)


def _with_dips(heights: Points, dip: Points) -> Points:
    """Heights where points low between both neighbours along x are only `dip` [m] lower than these,
    or as low as they are.

    Low is `MISSED_M` lower than the lower neighbour, as for a foot that misses its ground. Points
    at the rim of the scan are left as they are.
    """
    xp = namespace(heights)
    of, dips = (xp.reshape(each, (-1, *SCAN.shape)) for each in (heights, dip))
    edge, inner = xp.minimum(of[:, :-2], of[:, 2:]), of[:, 1:-1]
    inner = xp.where(inner < edge - MISSED_M, xp.maximum(inner, edge - dips[:, 1:-1]), inner)
    return xp.reshape(xp.concat([of[:, :1], inner, of[:, -1:]], axis=1), heights.shape)
