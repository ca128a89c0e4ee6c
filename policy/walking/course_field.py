"""The ground of walking robots: courses of a table, of which each robot has the nearest boxes.

A field of rubble has a hundred boxes, and every box that a robot has costs time in every physics
step; the scan reaches no further than 1 m.
"""

import torch
from torch import Tensor

from saltus.policy.walking.settings import GroundSettings
from saltus.terrain.boxes import Boxes

MISSED_M = 0.1
"""A foot whose centre is so much lower than edges on two sides of it missed its ground.

BeamDojo's bound, there of points of the sole (arXiv 2502.10363).
"""
REACH_M = 0.2
"""Distance from the foot at which edges are looked for: gaps to step over are not wider."""

EDGE_M = 0.05
"""A foot so near to a drop, along x or y of the world, stands beside it; the width of edges in
Extreme Parkour (arXiv 2309.14341)."""
DROP_M = 0.25
"""Ground so much lower than a foot's centre is a drop; deeper than a stair of any training."""


def in_trench(boxes: Boxes, foot: Tensor) -> Tensor:
    """Feet that are low between edges along x, or between edges along y, of the world.

    Args:
        boxes: The ground of each robot, arrays of shape (n, boxes, ...).
        foot: Their centres [m], shape (n, 4, 3).

    Returns:
        Bool, shape (n, 4).
    """
    ahead, behind, left, right = _heights_around(boxes, foot, REACH_M).unbind(-2)
    edge = torch.maximum(torch.minimum(ahead, behind), torch.minimum(left, right))
    return foot[..., 2] < edge - MISSED_M


def beside_drop(boxes: Boxes, foot: Tensor) -> Tensor:
    """Feet with ground that is `DROP_M` lower or more within `EDGE_M`, along x or y of the world;
    bool, shape (n, 4), of what `in_trench` takes.
    """
    return _heights_around(boxes, foot, EDGE_M).amin(-2) < foot[..., 2] - DROP_M


def _heights_around(boxes: Boxes, foot: Tensor, reach: float) -> Tensor:
    """The ground ahead, behind, left and right of each foot [m], shape (n, 4 sides, 4 feet)."""
    x, y = foot[..., 0], foot[..., 1]
    around_x = torch.cat([x + reach, x - reach, x, x], -1)
    around_y = torch.cat([y, y, y + reach, y - reach], -1)
    return boxes.height_at(around_x, around_y).unflatten(-1, (4, -1))


class CourseField:
    """All courses of a walking training on one device: which boxes are near a robot, and how much
    of its way is left.
    """

    def __init__(self, config: GroundSettings, like: Tensor) -> None:
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
            Arrays of shape (n, `GroundSettings.boxes`, ...).
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
