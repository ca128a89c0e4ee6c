"""Images that each of many robots has in hand, what its camera's effects make of new ones,
and images that lose pixels.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Array, namespace
from saltus.effects.camera import CameraChain, CameraState
from saltus.effects.signals import DepthImage, choose_images, nothing_yet


class LateImages:
    """The cameras of a batch, each with its memory; numpy or torch, as what they begin with.

    Args:
        chain: Effects of all cameras.
        state: Theirs before the first image.
        blank: An image of each robot, by whose shapes, types and device all others are; what is in
            it is not looked at.
    """

    def __init__(self, chain: CameraChain, state: CameraState, blank: DepthImage) -> None:
        self._chain, self._state = chain, state
        self._exposed = self.in_hand = nothing_yet(blank)
        """The newest images that have arrived."""

    def step(self, exposed: DepthImage | None, time_s: float, fresh: Array) -> Array:
        """Takes the newest images there are at `time_s` [s], None where they are those of before.

        Robots that are `fresh`, bool, shape (n,), have seen nothing before, and nothing is under
        way to them.

        Returns:
            Whose image in hand has just come, bool, shape (n,).
        """
        now, before_s = self._exposed, self.in_hand.time_s
        self._exposed = choose_images(fresh, nothing_yet(now), now) if exposed is None else exposed
        self.in_hand, self._state = self._chain.step(self._exposed, time_s, self._state, fresh)
        return self.in_hand.time_s > namespace(before_s).where(fresh, -math.inf, before_s)


BLANK_FROM_S = (3.0, 8.0)
"""Time of the run at which a camera goes blank, drawn for each trial [s]."""
_STREAM = 11  # of a trial's seed: other numbers than those of the trial itself


@dataclass(frozen=True, kw_only=True)
class ImageDamage:
    """Damage to the images of a camera; none by default."""

    gone: float = 0.0
    """Share of the pixels that are invalid, drawn for each image."""
    blank_s: float = 0.0
    """All pixels are invalid once for so long, from a drawn time on [s]."""

    def __call__(self, images: DepthImage, seeds: Sequence[int]) -> DepthImage:
        """The newest images of robots, shape (n, height, width), by the seeds of their trials."""
        if not self.gone and not self.blank_s:
            return images
        times_s = np.broadcast_to(images.time_s, len(seeds)).tolist()
        lost = np.stack([
            self._lost(images.depth.shape[1:], seed, time_s)
            for seed, time_s in zip(seeds, times_s, strict=True)
        ])  # fmt: skip
        return replace(images, depth=np.where(lost, np.zeros_like(images.depth), images.depth))

    def _lost(self, shape: tuple[int, ...], seed: int, time_s: float) -> NDArray[np.bool_]:
        since_s = time_s - np.random.default_rng((seed, _STREAM)).uniform(*BLANK_FROM_S)
        rng = np.random.default_rng((seed, _STREAM, round(1e3 * max(time_s, 0.0))))
        is_blank = 0.0 <= since_s < self.blank_s
        return (rng.uniform(size=shape) < self.gone) | is_blank
