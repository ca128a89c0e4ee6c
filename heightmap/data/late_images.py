"""Which image each of many robots has in hand, what its camera's effects make of those exposed, and which it uses."""

import math

from saltus.arrays import Array, namespace
from saltus.effects.camera import CameraChain, CameraState
from saltus.effects.signals import DepthImage, chosen, nothing_yet
from saltus.heightmap.service.service import INVALID_INVALID_PIXELS, LONGEST_GAP_S


class LateImages:
    """The cameras of a batch, each with its memory; numpy or torch, as what they begin with.

    Args:
        chain: Effects of all cameras.
        state: Theirs before the first image.
        blank: An image of each robot, by whose shapes, types and device all others are; what is in it is not looked at.
    """

    def __init__(self, chain: CameraChain, state: CameraState, blank: DepthImage) -> None:
        self._chain, self._state = chain, state
        self._exposed = self.in_hand = nothing_yet(blank)
        """The newest images that have arrived."""

    def step(self, exposed: DepthImage | None, time_s: float, fresh: Array) -> Array:
        """Takes the newest images there are at `time_s` [s], None where they are those of before.

        Robots that are `fresh`, bool, shape (n,), have seen nothing before, and nothing is under way to them.

        Returns:
            Whose image in hand has just come, bool, shape (n,).
        """
        now, before_s = self._exposed, self.in_hand.time_s
        self._exposed = chosen(fresh, nothing_yet(now), now) if exposed is None else exposed
        self.in_hand, self._state = self._chain.step(self._exposed, time_s, self._state, fresh)
        return self.in_hand.time_s > namespace(before_s).where(fresh, -math.inf, before_s)


class UsedImages:
    """The image that each robot's service uses: the newest that has come, unless hardly a pixel of it is valid.

    Args:
        blank: What a network is shown before the first, shape (n, 2, 48, 16); numpy or torch.
        like: Any times [s], float64, shape (n,).
    """

    def __init__(self, blank: Array, like: Array) -> None:
        self._blank = self.image = blank
        self.captured_s = namespace(like).full_like(like, -math.inf)
        """Capture times [s], shape (n,); minus infinity before the first."""

    def step(self, arrived: Array, image: Array, captured_s: Array, fresh: Array) -> tuple[Array, Array]:
        """Takes the images in hand of those robots for which one has just `arrived`, bool, shape (n,).

        Returns:
            Whose image in use is new, and whose service forgets what it saw, as nothing came for too long, shape (n,).
        """
        xp = namespace(image)
        before_s = xp.where(fresh, -math.inf, self.captured_s)
        new = arrived & (xp.mean(image[:, 1], axis=(-2, -1)) >= 1.0 - INVALID_INVALID_PIXELS)
        forgets = new & (before_s > -math.inf) & (captured_s > before_s + LONGEST_GAP_S)
        self.captured_s = xp.where(new, captured_s, before_s)
        kept = xp.where(fresh[:, None, None, None], self._blank, self.image)
        self.image = xp.where(new[:, None, None, None], image, kept)
        return new, forgets
