"""Heights for a planner, which cannot see behind edges: ground in doubt there is lowered.

An edge hides what is right behind it until the camera is over it, so no image shows the near side
of a trench. The network then predicts a slope from the edge to what it saw, with a wide interval:
the best guess over all kinds of ground. A planner that knows heights alone steps onto that slope.
Here points in doubt that lead down are lowered to the deepest of them; a trench whose ground nobody
saw becomes as deep as those that planners are trained on.
"""

import numpy as np

from saltus.arrays import Floats, Reals
from saltus.grid import HeightGrid
from saltus.terrain.terrain import TRENCH_DEPTH

DOUBT_M = 0.02
"""Half-width beyond which a point is in doubt: on level ground that was seen it is 0.010 to 0.018 m
(models/scan.md). With 0.025 m plans on ditches were a third farther from those on true heights,
with 0.018 m plans on stairs down by half."""
FALL_M = 0.03
"""Ground in doubt that lies deeper than this below the sure ground before it leads down."""
LEAD_M = 0.1
"""Points in doubt so far before a dip belong to it: drifting odometry moves edges by some cells."""
LEVEL_M = 0.05
"""Ground behind that lies less than this below the ground before makes a trench of the dip."""

RISES_M = 0.12
"""Ground behind that lies more than this above the ground before is the next tread of stairs that
lead up, whose edge is in doubt: no far side of a dip. Stairs in the policy's courses rise by 0.15 m
and more; far sides of their trenches are level."""


def deepen_shadows(height: Reals, half_width: Reals, grid: HeightGrid) -> tuple[Floats, Floats]:
    """Heights as a cautious planner takes them, and their half-widths,
    which still reach to the given heights.

    Args:
        height: Of the network, relative to the base [m], shape (points,).
        half_width: Of its 90 % intervals [m], shape (points,).
        grid: Places of the points; ground leads down along its x.
    """
    lower = np.array(height, np.float64).reshape(grid.shape)
    doubtful = (half_width > DOUBT_M).reshape(grid.shape)
    for column in range(grid.shape[1]):
        _deepen(lower[:, column], doubtful[:, column].tolist(), grid.x)
    lowered = lower.reshape(-1)
    return lowered, half_width + (height - lowered)


def _deepen(height: Floats, doubtful: list[bool], x: tuple[float, ...]) -> None:
    """Lowers what leads down in one column, in place."""
    count, before, first, done = len(height), float(height[0]), 0, 0
    while first < count:
        end = first
        while end < count and doubtful[end] and height[end] < before - FALL_M:
            end += 1
        if end == first:
            before = before if doubtful[first] else float(height[first])
            first += 1
            continue
        if end < count and height[end] > before + RISES_M:
            first = done = end
            continue
        lowest = min(height[first : end + 1])
        if end < count and height[end] > before - LEVEL_M:
            lowest = min(lowest, before - TRENCH_DEPTH)
        begin = first
        while begin > done and doubtful[begin - 1] and x[first] - x[begin - 1] <= LEAD_M:
            begin -= 1
        height[begin:end] = lowest
        first = done = end
