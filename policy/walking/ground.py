"""The ground of walking robots: courses of a table, of which each robot has the nearest boxes.

A field of rubble has a hundred boxes, and every box that a robot has costs time in every physics
step; the scan reaches no further than 1 m.
"""

import torch
from torch import Tensor

from saltus.policy.walking.settings import GroundConfig
from saltus.terrain.boxes import Boxes


class Ground:
    """All courses on one device."""

    def __init__(self, config: GroundConfig, like: Tensor) -> None:
        self.config, self.table = config, config.table.like(like)
        solid = self.table.solid
        low, high = (solid.center[..., :2] + side * solid.extent[..., :2] for side in (-1.0, 1.0))
        self._low, self._high = low.contiguous(), high.contiguous()
        is_real = (solid.center[..., 2:] > -50.0).expand_as(low)  # spare ones lie at -100 m
        self._from = torch.where(is_real, low, 1e6).amin(1) + config.margin_m
        self._to = torch.where(is_real, high, -1e6).amax(1) - config.margin_m

    def near(self, course: Tensor, position: Tensor) -> Boxes:
        """The nearest boxes of each robot, seen from above.

        Args:
            course: Its place in the table, int64, shape (n,).
            position: Of its base [m], shape (n, 2).

        Returns:
            Arrays of shape (n, `GroundConfig.boxes`, ...).
        """
        here = position[:, None]
        beyond = torch.maximum(self._low[course] - here, here - self._high[course]).clamp(min=0.0)
        distance = (beyond * beyond).sum(-1)
        nearest = distance.topk(self.config.boxes, dim=-1, largest=False, sorted=False).indices
        rows, solid = course[:, None], self.table.solid
        turn = torch.zeros_like(self._low) if solid.turn is None else solid.turn
        return Boxes(
            center=solid.center[rows, nearest],
            half_size=solid.half_size[rows, nearest],
            turn=turn[rows, nearest],
        )

    def left(self, course: Tensor, position: Tensor) -> Tensor:
        """Robots that came near to the rim of their ground, bool, shape (n,)."""
        return ((position < self._from[course]) | (position > self._to[course])).any(-1)
