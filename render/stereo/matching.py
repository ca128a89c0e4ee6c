"""Limits of a matcher: a wall behind all that is modelled, points that one imager alone sees,
steps and range of disparities, surfaces that return too little of the pattern.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from saltus.arrays import Array, Images, namespace
from saltus.effects.effect import Effect, PerRobot, parameter, per_image, setting
from saltus.effects.random_fields import draw_keys, gaussian_field, samples_across, unit_uniform
from saltus.render.single_image import SingleImageEffect
from saltus.render.stereo.image import StereoImage
from saltus.render.stereo.random_effect import RandomStereoEffect


@dataclass(frozen=True, kw_only=True)
class SearchRange(SingleImageEffect[StereoImage], name="search_range"):
    """Pixels whose match would lie beyond the range of the search,
    or beyond the right image, are invalid.

    `maximum` makes the minimum depth f B / maximum. `margin` is by how much the right image goes on
    to the left of where the left image begins; at 0 there is an invalid band of f B / z pixels at
    the left of the sensor, below 0 it is wider, as where half a matching window does not fit.
    """

    # 126 px (Intel: MinZ = f B / 126, 0.17 m at 848x480)
    maximum: PerRobot = parameter(unit="px", null=np.inf, low=1.0, high=1e4)
    # 0 px (D435 datasheet: the band is f B / z wide; a recorded D435 at 640x480 shows 12 px more)
    margin: PerRobot = parameter(unit="px", null=np.inf, low=-200.0, high=1e4)

    def changed(self, signal: StereoImage) -> StereoImage:
        """Invalidates what cannot be found."""
        disparity, optics = signal.disparity, signal.optics
        xp = namespace(disparity)
        column = xp.arange(disparity.shape[-1], dtype=disparity.dtype, device=disparity.device)
        column = (column + 0.5) * optics.pitch_x + optics.first_column
        found = (disparity <= per_image(self.maximum, disparity, xp)) & (
            disparity <= column + per_image(self.margin, disparity, xp)
        )
        return replace(signal, valid=signal.valid & found)


@dataclass(frozen=True, kw_only=True)
class DisparityStep(SingleImageEffect[StereoImage], name="disparity_step"):
    """Rounds disparities to whole multiples of `step`: steps of z^2 step / (f B) in depth."""

    # 1/32 px: five fractional bits (D4 vision processor)
    step: float = parameter(unit="px", null=0.0, low=0.0, high=2.0)

    def changed(self, signal: StereoImage) -> StereoImage:
        """Rounds."""
        xp = namespace(signal.disparity)
        return replace(signal, disparity=xp.round(signal.disparity * (1.0 / self.step)) * self.step)


@dataclass(frozen=True, kw_only=True)
class BaselineOcclusion(RandomStereoEffect, name="baseline_occlusion"):
    """Points that the right imager does not see are invalid:
    a shadow to the left of every near object.

    The shadow comes from a second view (`saltus.render.renderer.StereoRenderer`), so geometry makes
    its width: f B (1 / z_near - 1 / z_far) pixels. `rejected` is the share of such pixels that the
    camera's left-right check finds; it finds all of them, which is what the check is for (D4 vision
    processor datasheet).
    """

    rejected: PerRobot = parameter(unit="", null=0.0, low=0.0, high=1.0)

    def drawn(self, signal: StereoImage, keys: Array) -> StereoImage:
        """Invalidates what is hidden."""
        lost = signal.hidden
        if not np.all(np.equal(self.rejected, 1.0)):
            dtype = signal.disparity.dtype
            draw = unit_uniform(keys, signal.time_s, signal.hidden.shape[-2:], dtype)
            lost = lost & (draw < per_image(self.rejected, signal.disparity, namespace(draw)))
        return replace(signal, valid=signal.valid & ~lost)


@dataclass(frozen=True, kw_only=True)
class Background(SingleImageEffect[StereoImage], name="background"):
    """A wall at this distance, which faces the camera, where no ray hits anything nearer.

    At 6 m one pixel in 14 is lost to `WeakSignal`, and the noise is 0.3 m: "far" for the model,
    whose range is 3 m. What the right imager does not see is that of a scene without the wall:
    shadows before it are 1.2 px too wide.
    """

    # 6 m: a large room; within the 10 m that a D435i measures (D435i datasheet), twice the range of
    # the model
    distance: PerRobot = parameter(unit="m", null=np.inf, low=0.1, high=1e3)

    def changed(self, signal: StereoImage) -> StereoImage:
        """Puts the wall there."""
        xp = namespace(signal.disparity)
        wall = signal.optics.disparity_at_1m / per_image(self.distance, signal.disparity, xp)
        nearest = xp.zeros_like(signal.disparity[..., :1, :1]) + wall
        seen = xp.maximum(signal.disparity, nearest)
        return replace(signal, disparity=seen, truth=xp.maximum(signal.truth, nearest))


@dataclass(frozen=True, kw_only=True)
class WeakSignal(RandomStereoEffect, name="weak_signal"):
    """The pattern's return falls as cos(incidence) / z^2; below a threshold a pixel is invalid.

    At `reach` and normal incidence half of the pixels are lost; texture and reflectance vary by
    `spread` (standard deviation of the logarithm). What is not hit at all returns nothing.
    """

    # 10 m (D435i datasheet: depth up to about 10 m)
    reach: PerRobot = parameter(unit="m", null=np.inf, low=0.1, high=1e3)
    # matt surfaces indoors reflect 5 to 80 %: a factor of 4 either way within two standard
    # deviations
    spread: float = setting(0.7, unit="", low=0.01, high=5.0)
    patch: float = setting(5.0, unit="px", low=0.5, high=50.0)
    """Size of the patches that are lost together."""

    def drawn(self, signal: StereoImage, keys: Array) -> StereoImage:
        """Loses what returns too little."""
        disparity, optics = signal.truth, signal.optics
        xp = namespace(disparity)
        draw = self.patches(signal, keys, self.patch)
        # cos / z^2 over that at the reach; disparities stand for 1 / z
        weakest = optics.disparity_at_1m / per_image(self.reach, disparity, xp)
        draw *= self.spread
        needed = xp.exp(draw)
        needed *= weakest * weakest
        square = disparity * disparity
        steepness = square + _slopes_squared(
            disparity, optics.focal_px / optics.pitch_x, optics.focal_px / optics.pitch_y
        )
        # the cosine is disparity over the root of the steepness; both sides squared
        needed *= needed
        needed *= steepness
        strength = square * square
        strength *= square
        return replace(signal, valid=signal.valid & (strength > needed))


def _slopes_squared(disparity: Images, focal_x: float, focal_y: float) -> Images:
    """Square of the slope of the disparity per unit of tangent, for rays near the optical axis.

    A plane's disparity is linear in the image: slopes a, b (per unit of tangent) and value c at the
    pixel make the normal (a, b, c) in the frame of the pixel's own ray, so that the cosine of the
    incidence is c over its length.
    """
    xp = namespace(disparity)
    total = xp.zeros_like(disparity)
    for axis, focal in ((-2, focal_y), (-1, focal_x)):
        along, into = (xp.matrix_transpose(a) if axis == -2 else a for a in (disparity, total))
        slope = abs(along[..., 1:] - along[..., :-1])
        # the smaller of the slopes to both sides, so that an edge does not look like a grazing
        # surface; 0 at borders
        smaller = xp.minimum(slope[..., 1:], slope[..., :-1])
        smaller *= focal
        smaller *= smaller
        into[..., 1:-1] += smaller
    return total


DisparityNoiseState = tuple[Array, Array, Array]
"""Keys, time of the last image, and its noise, None before the first."""


@dataclass(frozen=True, kw_only=True)
class DisparityNoise(Effect[StereoImage], name="disparity_noise", site="depth"):
    """Adds to the disparity a Gaussian field that is correlated in the image and in time.

    Depth then has the standard deviation z^2 sigma / (f B). Neighbouring pixels share most of their
    matching window, so the correlation falls linearly, to 1/e at `correlation`. From frame to frame
    it falls exponentially.
    """

    # 0.08 px in practice, 0.03 px at best (Intel on the D4xx)
    sigma: PerRobot = parameter(unit="px", null=0.0, low=0.0, high=2.0)
    # 1/e of the correlation of a D435 at 640x480 lies at 10 px across and 7 px down: the size of
    # the window
    correlation: float = setting(9.0, unit="px", low=0.1, high=100.0)
    # D435 at 2 m: 3.6 mm of noise at a pixel over time, 5.2 mm over a plane, so half the variance
    # stays from frame to frame, at 50 Hz: 0.020 s / ln 2
    persistence_s: float = setting(0.029, unit="s", low=0.0, high=1e3)

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> DisparityNoiseState:
        """A key for each image, and no noise yet."""
        return draw_keys(batch, rng), None, None

    def apply(
        self, signal: StereoImage, time_s: float, state: DisparityNoiseState
    ) -> tuple[StereoImage, DisparityNoiseState]:
        """Adds the noise."""
        del time_s
        if self.is_null():
            return signal, state
        keys, last_s, last = state
        xp, optics, disparity = namespace(signal.disparity), signal.optics, signal.disparity
        window = self.window(optics.pitch_y), self.window(optics.pitch_x)
        noise = gaussian_field(keys, signal.time_s, disparity.shape[-2:], window, disparity.dtype)
        if last is not None and self.persistence_s > 0.0:
            elapsed = signal.time_s - last_s
            kept = xp.exp(
                -xp.where(elapsed > 0.0, elapsed, xp.zeros_like(elapsed)) / self.persistence_s
            )
            kept = xp.astype(kept, disparity.dtype)[..., None, None]
            noise *= xp.sqrt(1.0 - kept * kept)
            noise += last * kept
        scale = per_image(self.sigma, disparity, xp) * self._averaged(
            optics.pitch_x, optics.pitch_y
        )
        # nothing hit stays nothing; less than no disparity does not exist
        noisy = scale * noise
        noisy += disparity
        noisy = xp.where(
            (disparity > 0.0) & (noisy > 0.0), noisy, xp.zeros_like(disparity[..., :1, :1])
        )
        return replace(signal, disparity=noisy), (keys, signal.time_s, noise)

    def window(self, pitch: float) -> int:
        """Samples over which the noise is a moving average, at a pitch [px] between samples."""
        return samples_across(self.correlation / (1.0 - math.exp(-1.0)), pitch)

    def _averaged(self, *pitches: float) -> float:
        """Noise where one sample stands for all pixels in its place: that of their average."""
        share = 1.0
        for pitch in pitches:
            # mean distance of two of n pixels in a row is (n - 1/n) / 3
            share *= max(
                0.0, 1.0 - (pitch - 1.0 / pitch) / 3.0 * (1.0 - math.exp(-1.0)) / self.correlation
            )
        return math.sqrt(share)
