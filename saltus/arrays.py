"""One law for numpy or floats (deployed) and torch (training):
namespace and constants come from its input.
"""

import itertools
import math
import sys
from collections import namedtuple
from types import ModuleType, SimpleNamespace
from typing import TYPE_CHECKING, Any, TypeAlias

import array_api_compat
import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats: TypeAlias = NDArray[np.float64]
"""A numpy array of doubles; docstrings say its shape and unit."""
Singles: TypeAlias = NDArray[np.float32]
"""A numpy array in single precision: inputs and outputs of networks, and copies on disk."""
Reals: TypeAlias = NDArray[np.floating]
"""A numpy array of either precision."""
Indices: TypeAlias = NDArray[np.int64]
"""A numpy array of whole numbers: places in another array, or counts."""
AnyArray: TypeAlias = NDArray[Any]
"""A numpy array of any type: what is stored, sent and read."""
Array: TypeAlias = Any
"""A numpy array or a torch tensor: the array API standard has no static type yet.

Where a law says so, also a float.
"""

# Shapes are types where jaxtyping was imported first, as tests do that check them; elsewhere they
# cost nothing.
if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import Bool, Float, Shaped
else:

    class Shaped:
        """Stands for a type of jaxtyping, which is not there: any array."""

        def __class_getitem__(cls, _: object) -> Any:
            """Any array, whatever its shape."""
            return Any

    Bool = Float = Shaped

if TYPE_CHECKING:
    Number: TypeAlias = Any
else:
    Number = Any | float

Scalars: TypeAlias = Float[Number, "*batch"]
"""A number for each robot of a batch, which may be of one robot, shape (...); or a float."""
Vectors: TypeAlias = Float[Array, "*batch 3"]
"""A vector for each robot."""
Quaternions: TypeAlias = Float[Array, "*batch 4"]
"""A rotation (w, x, y, z) for each robot."""
Rotations: TypeAlias = Float[Array, "*batch 3 3"]
"""A matrix for each robot."""
Joints: TypeAlias = Float[Array, "*batch 12"]
"""A number for each joint, or the forces of all feet, in the order of `saltus.robots.robot`."""
Legs: TypeAlias = Float[Array, "*batch 4 3"]
"""A vector for each leg: FR, FL, RR, RL."""
Jacobians: TypeAlias = Float[Array, "*batch 4 3 3"]
"""A matrix for each leg."""
PerLeg: TypeAlias = Float[Array, "*batch 4"]
"""A number for each leg."""
LegFlags: TypeAlias = Bool[Array, "*batch 4"]
"""True or false for each leg."""
Flags: TypeAlias = Bool[Array, "*batch"]
"""True or false for each robot."""
Counts: TypeAlias = Shaped[Number, "*batch"]
"""A whole number for each robot, which may be kept as a float."""
MotionEstimates: TypeAlias = Float[Array, "*batch 4"]
"""Velocity in the world and height of each robot."""
JointMatrices: TypeAlias = Float[Array, "*batch 12 12"]
"""A square matrix over the forces of all feet, for each robot."""
Levers: TypeAlias = Float[Array, "*batch 12 6"]
"""Linear and angular acceleration by the force of each foot, transposed."""
BodyAccelerations: TypeAlias = Float[Array, "*batch 6"]
"""Linear and angular acceleration of each robot."""
AccelerationPairs: TypeAlias = Float[Array, "*batch 2 3"]
"""Linear and angular acceleration of each robot, one below the other."""
Images: TypeAlias = Shaped[Array, "*batch height width"]
"""An image for each robot."""
Masks: TypeAlias = Bool[Array, "*batch height width"]
"""True or false for each pixel of each image."""
BoxVectors: TypeAlias = Float[Array, "*batch boxes 3"]
"""A vector for each box of each robot."""
BoxAngles: TypeAlias = Float[Array, "*batch boxes 2"]
"""Two angles for each box."""
BoxQuaternions: TypeAlias = Float[Array, "*batch boxes 4"]
"""A rotation (w, x, y, z) for each box."""
BoxRotations: TypeAlias = Float[Array, "*batch boxes 3 3"]
"""A matrix for each box."""
Steps: TypeAlias = Float[Array, "*batch columns"]
"""A number for each column of each robot's course."""
Places: TypeAlias = Float[Array, "*batch axes"]
"""A place for each robot: x and y, or x, y and z."""
Points: TypeAlias = Float[Array, "*batch points"]
"""A number for each point of each robot, e.g. its height."""

FLOATS = SimpleNamespace(
    sin=math.sin,
    cos=math.cos,
    asin=math.asin,
    atan2=math.atan2,
    clip=lambda value, low, high: min(max(value, low), high),
)
"""Functions of the standard that laws call, for Python's own floats: a call on a small array costs
ten times its arithmetic."""

# numpy 2 is the standard's namespace itself; the compatibility layer's wrappers would cost a
# quarter of a control tick.
Namespace: TypeAlias = ModuleType | SimpleNamespace
"""The functions for one kind of array: numpy, torch behind the array API, or `FLOATS`."""
_NAMESPACES: dict[type, Namespace] = {np.ndarray: np, np.float64: np, float: FLOATS}


def namespace(array: Array) -> Namespace:
    """The array API namespace of `array`.

    Looked up once per array type, because the lookup costs 4 us.
    """
    found = _NAMESPACES.get(type(array))
    if found is None:
        found = _NAMESPACES[type(array)] = array_api_compat.array_namespace(array)
    return found


def smooth_step(t: Array) -> Array:
    """From 0 to 1 while `t` goes from 0 to 1, at rest at both ends; any shape."""
    t = namespace(t).clip(t, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


class Constant:
    """A fixed array that takes the library, dtype and device of whatever it meets.

    Each conversion happens once.
    """

    def __init__(self, value: ArrayLike) -> None:
        # Torch wants arrays that can be written
        self._value: NDArray[np.float64] = np.array(value, dtype=np.float64)
        self._converted: dict[tuple[type, object, object], Array] = {}

    def like(self, reference: Array) -> Array:
        """The constant as an array of the same kind as `reference`."""
        if type(reference) is np.ndarray and reference.dtype == self._value.dtype:
            return self._value
        device = reference.device
        key = (type(reference), reference.dtype, device)
        found = self._converted.get(key)
        if found is None:
            xp = namespace(reference)
            found = self._converted[key] = xp.asarray(
                self._value, dtype=reference.dtype, device=device
            )
        return found


class ColumnNames:
    """Names for columns of an array, e.g. of one that holds uniform random numbers:
    each has a shape, () or (k,).
    """

    def __init__(self, **shapes: tuple[int, ...]) -> None:
        ends = list(itertools.accumulate(math.prod(shape) for shape in shapes.values()))
        self.count = ends[-1]
        """Number of columns of all names together."""
        widths = zip(ends, shapes.values(), strict=True)
        self._places = [slice(end - shape[0], end) if shape else end - 1 for end, shape in widths]
        make: Any = namedtuple  # whose names are known only here
        self._named = make("_named", shapes)

    def of(self, array: Array) -> Any:
        """Columns of an array (n, count) as attributes of their names, (n,) or (n, k)."""
        return self._named(*(array[:, place] for place in self._places))
