"""Columns of the tables that other programs read, for people and for programs.

To write them takes pyarrow alone.
"""

from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from saltus.arrays import AnyArray
from saltus.grid import HeightGrid
from saltus.heightmap.service.proprioception_vector import PROPRIOCEPTION

NO_IMAGE_S = -1.0
"""Age of the image of a tick before the first one."""
_IMAGE = pa.list_(pa.list_(pa.uint16()))
_VECTOR = pa.list_(pa.float32())


@dataclass(frozen=True)
class ExportColumn:
    """A column of the table: what it holds, for people and for both formats."""

    name: str
    kind: pa.DataType
    dtype: str
    shape: tuple[int, ...]
    about: str
    names: tuple[str, ...] | None = None


def columns_of(grid: HeightGrid) -> tuple[ExportColumn, ...]:
    """The columns of a table of heights on a grid, a line of points ahead of the base."""
    return (
        ExportColumn("observation.state", _VECTOR, "float32", (len(PROPRIOCEPTION),),
            "what the robot knows of itself: "
               "angles [rad], positions [m], velocities [m/s, rad/s], in the yaw frame",
               PROPRIOCEPTION),
        ExportColumn("observation.depth", _IMAGE, "uint16", (48, 16),
            "newest depth image [mm], along the optical axis; 0 "
               "is invalid, 65535 nothing within range"),
        ExportColumn("observation.depth_age", pa.float32(), "float32", (1,),
            "time since it was taken [s]; -1 before the "
               "first"),
        ExportColumn("label.height", _VECTOR, "float32", (grid.size,),
            "true heights relative to the base [m], at these x "
               "ahead of it along its yaw [m]", tuple(f"{x:.4f}" for x in grid.x)),
        ExportColumn("timestamp", pa.float32(), "float32", (1,), "since the episode began [s]"),
        ExportColumn("frame_index", pa.int64(), "int64", (1,), "tick of the episode"),
        ExportColumn("episode_index", pa.int64(), "int64", (1,),
            "one robot, one run, without interruption"),
        ExportColumn("index", pa.int64(), "int64", (1,), "row"),
        ExportColumn("task_index", pa.int64(), "int64", (1,), "terrain, see meta/tasks.parquet"),
    )  # fmt: skip


def nested_lists(values: AnyArray, kind: pa.DataType) -> pa.Array:
    """Rows of any shape as lists of lists, without a Python object for each number."""
    array: pa.Array = pa.array(np.ascontiguousarray(values).reshape(-1))
    for size in values.shape[:0:-1]:
        array = pa.ListArray.from_arrays(
            pa.array(np.arange(0, len(array) + 1, size, dtype=np.int32)), array
        )
    return array.cast(kind)
