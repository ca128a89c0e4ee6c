"""The signal between the effects of a stereo camera, and what they ask about the neighbourhood of
every pixel.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from saltus.arrays import Floats, Images, Masks, Scalars, namespace
from saltus.effects.random_fields import extreme_around
from saltus.render.stereo.optics import StereoOptics


class Morphology(Protocol):
    """Erosion and dilation of images, by any library; beyond a border counts as the border does.

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
        return extreme_around(mask, rows, columns, namespace(mask).logical_or)

    def range_around(self, values: Images) -> tuple[Images, Images]:
        """See `Morphology`."""
        xp = namespace(values)
        return extreme_around(values, 1, 1, xp.minimum), extreme_around(values, 1, 1, xp.maximum)


ARRAY_WINDOWS = ArrayWindows()


@dataclass(frozen=True, kw_only=True, eq=False)
class StereoImage:
    """Image that the matcher of a stereo camera has found so far,
    for any leading batch dimensions, numpy or torch.
    """

    disparity: Floats
    """Column in the left image less column in the right image [px of the sensor]; 0 where nothing
    is hit. Shape (..., height, width)."""
    truth: Floats
    """Disparity of the scene itself [px], on which it depends what is lost.

    Shape (..., height, width).
    """
    valid: Masks
    """True where there is a match, bool, shape (..., height, width)."""
    hidden: Masks
    """True where the right imager does not see the point, bool, shape (..., height, width)."""
    time_s: Floats
    """Capture time in the run's clock [s], float64, shape (...)."""
    optics: StereoOptics
    windows: Morphology = ARRAY_WINDOWS
    """For looking around pixels."""


def stereo_image(
    depth: Images,
    hidden: Masks,
    time_s: Scalars,
    optics: StereoOptics,
    windows: Morphology = ARRAY_WINDOWS,
) -> StereoImage:
    """A perfect match of a rendered scene.

    Args:
        depth: along the optical axis [m], infinite where nothing is hit, shape (..., height,
            width).
        hidden: see `StereoImage`.
        time_s: see `StereoImage`.
        optics: of the camera.
        windows: see `StereoImage`.
    """
    disparity = optics.disparity_at_1m / depth
    xp = namespace(depth)
    return StereoImage(
        disparity=disparity,
        truth=disparity,
        valid=xp.ones_like(hidden),
        hidden=hidden,
        time_s=time_s,
        optics=optics,
        windows=windows,
    )


def depth_of(image: StereoImage) -> Images:
    """Depth [m] along the optical axis: infinite where nothing is hit, 0 where invalid.

    Shape (..., height, width).
    """
    xp = namespace(image.disparity)
    with np.errstate(divide="ignore"):
        depth = image.optics.disparity_at_1m / image.disparity
    return xp.where(image.valid, depth, xp.zeros_like(depth[..., :1, :1]))
