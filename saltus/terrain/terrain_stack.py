"""Many terrains at once, one for each robot of a batch."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from saltus.arrays import Array, Floats
from saltus.terrain.boxes import Boxes
from saltus.terrain.columns import column_heights
from saltus.terrain.terrain import Terrain

# A box that a terrain does not need lies this deep below its end, out of everything's way [m]
SPARE_DEPTH = -100.0
SPARE_SIZE = 0.02  # [m]


@dataclass(frozen=True)
class TerrainStack:
    """Terrain `i` belongs to robot `i`."""

    terrains: Sequence[Terrain]

    @cached_property
    def widest(self) -> int:
        """Number of boxes of the terrain that has the most."""
        return max(len(terrain.boxes) for terrain in self.terrains)

    @cached_property
    def finish_x(self) -> Floats:
        """[m], shape (robots,)."""
        return np.array([terrain.finish_x for terrain in self.terrains])

    def height_at(self, x: Array, y: Array) -> Array:
        """Height of each robot's terrain [m], as `Terrain.height_at`.

        Args:
            x: World x [m], numpy or torch, shape (robots, points).
            y: World y [m], the same shape.

        Returns:
            Shape (robots, points).
        """
        if self._columns is not None:
            return column_heights(*self._columns, x)
        return self.ground.like(x).height_at(x, y)

    def boxes(self, count: int) -> Boxes:
        """Exactly `count` boxes for each robot, with spare ones far below.

        Arrays of shape (robots, count, ...).
        """
        boxes = self._repeated(count)
        robot, box = np.nonzero(
            np.arange(count) >= np.array([[len(terrain.boxes)] for terrain in self.terrains])
        )
        ends = np.array([terrain.boxes[-1].high[0] for terrain in self.terrains])
        boxes.center[robot, box] = np.stack([ends, 0.0 * ends, 0.0 * ends + SPARE_DEPTH], axis=-1)[
            robot
        ]
        boxes.half_size[robot, box] = 0.5 * SPARE_SIZE
        return boxes

    @cached_property
    def _columns(self) -> tuple[Floats, Floats] | None:
        """Walls, padded with infinity, and tops [m], where all terrains are columns."""
        columns = [terrain.columns for terrain in self.terrains]
        if any(each is None for each in columns):
            return None
        walls = [_padded(each.x[1:-1], self.widest - 1, np.inf) for each in columns if each]
        return np.stack(walls), np.stack(
            [_padded(each.top, self.widest, 0.0) for each in columns if each]
        )

    @cached_property
    def ground(self) -> Boxes:
        """Boxes that are as high as the terrains, in arrays of one size.

        For solid ones see `boxes`.
        """
        return self._repeated(self.widest)

    def _repeated(self, count: int) -> Boxes:
        """`count` boxes for each robot.

        The last one of a terrain stands for those that it lacks.
        """
        rows = [np.minimum(np.arange(count), len(terrain.boxes) - 1) for terrain in self.terrains]
        boxes = [terrain.arrays for terrain in self.terrains]

        def stacked(name: str) -> Floats:
            return np.stack(
                [getattr(each, name)[row] for each, row in zip(boxes, rows, strict=True)]
            )

        is_level = all(each.turn is None for each in boxes)
        return Boxes(
            center=stacked("center"),
            half_size=stacked("half_size"),
            turn=None if is_level else stacked("angles"),
        )


def _padded(values: Floats, length: int, fill: float) -> Floats:
    return np.concatenate([values, np.full(length - len(values), fill)])
