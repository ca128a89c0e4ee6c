"""Images that each of many robots has in hand, and what its camera's effects make of new ones."""

import math

from saltus.arrays import Array, namespace
from saltus.effects.camera import CameraChain, CameraState
from saltus.effects.signals import DepthImage, chosen, nothing_yet


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
        self._exposed = chosen(fresh, nothing_yet(now), now) if exposed is None else exposed
        self.in_hand, self._state = self._chain.step(self._exposed, time_s, self._state, fresh)
        return self.in_hand.time_s > namespace(before_s).where(fresh, -math.inf, before_s)
