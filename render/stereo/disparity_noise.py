"""A matcher finds each disparity only up to a fraction of a pixel."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from saltus.arrays import Array, namespace
from saltus.effects.effect import Effect, PerRobot, parameter, per_image
from saltus.effects.fields import draw_keys, gaussian, samples
from saltus.render.stereo.image import StereoImage

Memory = tuple[Array, Array, Array]
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
    correlation: float = field(
        default=9.0, metadata={"unit": "px", "low": 0.1, "high": 100.0, "per_joint": False}
    )
    # D435 at 2 m: 3.6 mm of noise at a pixel over time, 5.2 mm over a plane, so half the variance
    # stays from frame to frame, at 50 Hz: 0.020 s / ln 2
    persistence_s: float = field(
        default=0.029, metadata={"unit": "s", "low": 0.0, "high": 1e3, "per_joint": False}
    )

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> Memory:
        """A key for each image, and no noise yet."""
        return draw_keys(batch, rng), None, None

    def apply(
        self, signal: StereoImage, time_s: float, state: Memory
    ) -> tuple[StereoImage, Memory]:
        """Adds the noise."""
        del time_s
        if self.is_null():
            return signal, state
        keys, last_s, last = state
        xp, optics, disparity = namespace(signal.disparity), signal.optics, signal.disparity
        window = self.window(optics.pitch_y), self.window(optics.pitch_x)
        noise = gaussian(keys, signal.time_s, disparity.shape[-2:], window, disparity.dtype)
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
        return samples(self.correlation / (1.0 - math.exp(-1.0)), pitch)

    def _averaged(self, *pitches: float) -> float:
        """Noise where one sample stands for all pixels in its place: that of their average."""
        share = 1.0
        for pitch in pitches:
            # mean distance of two of n pixels in a row is (n - 1/n) / 3
            share *= max(
                0.0, 1.0 - (pitch - 1.0 / pitch) / 3.0 * (1.0 - math.exp(-1.0)) / self.correlation
            )
        return math.sqrt(share)
