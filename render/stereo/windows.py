"""Questions of effects about the neighbourhood of every pixel, and who answers them."""

from dataclasses import dataclass
from typing import Protocol

from saltus.arrays import Images, Masks, namespace
from saltus.effects.fields import around


class Morphology(Protocol):
    """Morphology of images; what lies beyond a border counts as the border does.

    A frozen value without fields.
    """

    def any_around(self, mask: Masks, rows: int, columns: int) -> Masks:
        """True where anything is set within `rows` and `columns` of each sample,
        bool, shape (..., height, width).
        """
        ...

    def range_around(self, values: Images) -> tuple[Images, Images]:
        """The least and the largest of the nine values around each sample,
        both of shape (..., height, width).
        """
        ...


@dataclass(frozen=True)
class ArrayWindows:
    """For any library of arrays: extremes of windows of 1, 2, 4, ... samples, so few operations."""

    def any_around(self, mask: Masks, rows: int, columns: int) -> Masks:
        """See `Morphology`."""
        return around(mask, rows, columns, namespace(mask).logical_or)

    def range_around(self, values: Images) -> tuple[Images, Images]:
        """See `Morphology`."""
        xp = namespace(values)
        return around(values, 1, 1, xp.minimum), around(values, 1, 1, xp.maximum)


ARRAY_WINDOWS = ArrayWindows()
