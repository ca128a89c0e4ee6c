"""The filters that librealsense offers for depth images, as the original's robot ran them.

Order: hole filling, spatial, temporal, on depth in whole units (not on disparity). All follow the
    behaviour of
librealsense 2 on 16-bit depth, scan order included, with whole-array operations for numpy and torch
alike.

What that behaviour amounts to at the original's settings: blending neighbours that differ by at
most `delta` moves a pixel by less than (1 - alpha) delta, which is below half a unit at alpha =
0.75 and delta = 1, so rounding undoes all smoothing. Only holes are filled.
"""

from dataclasses import dataclass, replace
from typing import TypeAlias

from saltus.arrays import Array, Images, namespace
from saltus.depth import MILLIMETRE
from saltus.effects.effect import Effect, parameter, setting
from saltus.effects.signals import DepthImage
from saltus.render.holes import filled_along_rows, filled_from_around, on_host
from saltus.render.single_image import SingleImageEffect

LARGEST = 65535  # of the 16 bits of a pixel; what is farther is sent as 0


@dataclass(frozen=True, kw_only=True)
class DepthUnit(SingleImageEffect[DepthImage], name="depth_unit"):
    """Rounds depth [m] to whole units; 0 is invalid,
    and so is what is farther than 16 bits can say.
    """

    # 1 mm (librealsense: default of the D400 family)
    unit: float = parameter(unit="m", null=0.0, low=0.0, high=0.1)

    def changed(self, signal: DepthImage) -> DepthImage:
        """Rounds."""
        xp = namespace(signal.depth)
        count = xp.round(signal.depth * (1.0 / self.unit))
        fits = count < LARGEST
        count *= self.unit
        return replace(signal, depth=xp.where(fits, count, xp.zeros_like(count[..., :1, :1])))


ROUNDED_AWAY = 0.5  # a change below half a unit
HALF = 0.5  # depths are whole units, so that "less than n units" is "less than n - 1/2"
FLOAT_SLACK = 1e-2  # of a unit: float32 metres are whole units only up to rounding
LAST_FOUR = 0b1111  # frames
# Pixels by level of the option (librealsense; the last is "unlimited")
HOLE_RADIUS = (
    0,
    2,
    4,
    8,
    16,
    256,
)


Remembered: TypeAlias = tuple[Array, Array, Array, Array]


def _unit() -> float:
    """The depth unit [m]: what filters round to and count differences in."""
    return setting(MILLIMETRE, unit="m", low=1e-6, high=0.1)


@dataclass(frozen=True, kw_only=True)
class HoleFilling(SingleImageEffect[DepthImage], name="hole_filling"):
    """An invalid pixel takes the nearest depth among its neighbours above,
    to the left and below left.

    Pixels are visited row by row, so filled ones fill others. The pixel above must be valid, or
    filled: holes that begin in the top row stay. The first column, the top and the bottom row are
    not filled.
    """

    # 2 is "nearest from around" (original)
    mode: float = parameter(unit="", null=0.0, low=2.0, high=2.0)

    def changed(self, signal: DepthImage) -> DepthImage:
        """Fills holes."""
        if min(signal.depth.shape[-2:]) < 3:
            return signal
        return replace(signal, depth=filled_from_around(signal.depth))


@dataclass(frozen=True, kw_only=True)
class SpatialFilter(SingleImageEffect[DepthImage], name="spatial_filter"):
    """Edge-preserving exponential smoothing, forth and back along rows,
    then along columns, `magnitude` times.

    Along rows a pixel is blended with the one before it where they differ by at most `delta` units,
    along columns where they differ by less. On the way along rows, holes take the value before
    them, up to a radius from the last valid pixel.
    """

    # original: 5
    magnitude: float = parameter(unit="", null=0.0, low=1.0, high=5.0)
    # weight of the pixel itself (original: 0.75)
    alpha: float = parameter(unit="", null=1.0, low=0.25, high=1.0)
    # in depth units (original: 1)
    delta: float = parameter(unit="", null=0.0, low=1.0, high=50.0)
    # level of `HOLE_RADIUS` (original: 4)
    holes_fill: float = parameter(unit="", null=0.0, low=0.0, high=5.0)
    unit: float = _unit()

    def changed(self, signal: DepthImage) -> DepthImage:
        """Smooths and fills."""
        if self.magnitude == 0.0 or signal.depth.shape[-1] < 3:
            return signal
        reach, passes = HOLE_RADIUS[round(self.holes_fill)] - 1, round(self.magnitude)
        if (1.0 - self.alpha) * self.delta < ROUNDED_AWAY:
            return replace(signal, depth=filled_along_rows(signal.depth, reach, passes))
        depth = signal.depth
        for _ in range(passes):
            depth = self._smoothed(filled_along_rows(depth, reach))
        return replace(signal, depth=depth)

    def _smoothed(self, depth: Images) -> Images:
        """One pass forth and back along rows and columns."""
        xp = namespace(depth)
        image = xp.round(depth * (1.0 / self.unit))
        for axis, limit in ((-1, self.delta), (-2, self.delta - 1.0)):
            lines = [
                image[..., i, :] if axis == -2 else image[..., i] for i in range(image.shape[axis])
            ]
            # Forward along rows, the last column is left out
            last = len(lines) - 1 if axis == -1 else len(lines)
            for order in (range(1, last), range(len(lines) - 2, -1, -1)):
                step = 1 if order.step > 0 else -1
                for i in order:
                    lines[i] = self._blended(lines[i], lines[i - step], limit)
            image = xp.stack(lines, axis=axis)
        return image * self.unit

    def _blended(self, pixel: Array, before: Array, limit: float) -> Array:
        xp = namespace(pixel)
        blend = xp.floor(self.alpha * pixel + (1.0 - self.alpha) * before + ROUNDED_AWAY)
        close = (pixel > 0.0) & (before > 0.0) & (xp.abs(pixel - before) <= limit)
        return xp.where(close, blend, pixel)


@dataclass(frozen=True, kw_only=True)
class TemporalFilter(Effect[DepthImage], name="temporal_filter", site="depth"):
    """Exponential smoothing in time where a pixel changed by less than `delta` units.

    Holes take an older value.

    A hole is filled where the last values agreed within `delta` in two of the last four frames
    (librealsense's default persistence). The blend is cut to whole units, not rounded.
    """

    # weight of the new frame (original: 0.75)
    alpha: float = parameter(unit="", null=1.0, low=0.0, high=1.0)
    # in depth units (original: 1)
    delta: float = parameter(unit="", null=0.0, low=1.0, high=100.0)
    unit: float = _unit()

    def apply(
        self, signal: DepthImage, time_s: float, state: Remembered | None
    ) -> tuple[DepthImage, Remembered | None]:
        """Smooths, fills, and remembers; an image that comes again changes nothing.

        The state is (depth kept, agreement of the last four frames as bits, capture time, image
        given out).
        """
        del time_s
        if self.delta == 0.0:
            return signal, state
        depth = signal.depth
        xp = namespace(depth)
        if state is None:
            history = xp.astype(depth > 0.0, xp.uint8)
            return signal, (depth, history, signal.time_s, depth)
        kept, history, last_s, given = state
        repeated = (signal.time_s == last_s)[..., None, None]
        valid = depth > 0.0
        agrees = valid & (abs(depth - kept) < (self.delta - HALF) * self.unit)
        result = depth
        if self.delta > 1.0:  # below, only equal values agree
            agrees = agrees & (kept > 0.0)
            count = self.alpha * depth + (1.0 - self.alpha) * kept
            count = xp.floor(xp.where(agrees, count, depth) * (1.0 / self.unit) + FLOAT_SLACK)
            result = xp.where(agrees, count * self.unit, depth)
        twice = (history & (history - 1)) != 0  # what is left of a number without its lowest bit
        output = xp.where(valid | ~twice, result, kept)
        # a bit enters on the right; where the value is new, older bits go
        known = xp.astype(valid, xp.uint8)
        following = (history << 1) & (
            LAST_FOUR * (xp.astype(agrees, xp.uint8) | (1 - known))
        ) | known
        following_kept = xp.where(valid, result, kept)
        if not on_host(repeated) or bool(xp.any(repeated)):
            output = xp.where(repeated, given, output)
            following, following_kept = (
                xp.where(repeated, history, following),
                xp.where(repeated, kept, following_kept),
            )
        return replace(signal, depth=output), (following_kept, following, signal.time_s, output)
