"""Effects of a stereo matcher that draw at random."""

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Array, Images
from saltus.effects.effect import Effect
from saltus.effects.random_fields import draw_keys, gaussian_field, samples_across
from saltus.render.stereo.image import StereoImage


@dataclass(frozen=True, kw_only=True)
class RandomStereoEffect(Effect[StereoImage], site="depth"):
    """Draws from a key for each image and the capture time: the key is all its state."""

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> Array:
        """A key for each image."""
        return draw_keys(batch, rng)

    def apply(self, signal: StereoImage, time_s: float, state: Array) -> tuple[StereoImage, Array]:
        """See `Effect.apply`."""
        del time_s
        return (signal if self.is_null() else self.drawn(signal, state)), state

    @abstractmethod
    def drawn(self, signal: StereoImage, keys: Array) -> StereoImage:
        """The image after the effect."""

    @staticmethod
    def patches(signal: StereoImage, keys: Array, size: float) -> Images:
        """Standard normal numbers that are alike within patches of that size [px],
        shape (..., height, width).
        """
        window = (
            samples_across(size, signal.optics.pitch_y),
            samples_across(size, signal.optics.pitch_x),
        )
        return gaussian_field(
            keys, signal.time_s, signal.truth.shape[-2:], window, signal.truth.dtype
        )
