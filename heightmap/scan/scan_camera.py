"""Points of depth images in the base frame, by each camera's calibration and place."""

from typing import NamedTuple

import numpy as np

from saltus.arrays import Floats, Singles
from saltus.depth import NOTHING, Intrinsics, intrinsics_of
from saltus.robots.mount import Mount
from saltus.wire.messages import DepthFrame

PIXELS = 48 * 64
"""Number of pixels that are read of an image, about: as many as those of training have
(`FlightSettings.rows`, `columns`)."""
REACH_M = 3.0
"""Nearer ground should be seen: stereo cameras measure it (D435i datasheet: 0.3 to 3 m)."""
FEWEST = 20
"""Number of pixels that look at near ground below which nothing is said about them."""


class ImagePoints(NamedTuple):
    """The points of one depth image; pixels without depth are left out."""

    points: Singles
    """Base frame at the exposure [m], shape (n, 3)."""
    depth: Singles
    """Along the camera's axis [m], shape (n,)."""
    missing: float
    """Share without depth of those pixels that would see level ground within `REACH_M`."""


class ScanCamera:
    """One depth camera on a robot, as the scan uses it: its mount, how well that is known, and its
    range.

    Attributes:
        position: Of the camera in the base [m], shape (3,).

    Args:
        mount: Its pose in the base.
        range_m: Nearest and farthest depth that is believed [m]; None: all.
        mount_error: See `saltus.depth_camera.DepthCamera`.
    """

    def __init__(
        self, mount: Mount, range_m: tuple[float, float] | None = None, mount_error: float = 1.0
    ) -> None:
        self.mount_error = mount_error
        self.position = np.asarray(mount.position, np.float32)
        self._rotation = np.asarray(mount.rotation, np.float32)
        self._range_m = range_m
        self._lens: Intrinsics | None = None
        self._looks, self._step = np.zeros((3, 0), np.float32), 1

    def points(self, frame: DepthFrame, up: Floats, base_height: float) -> ImagePoints:
        """Points of an image.

        Args:
            frame: The image; its intrinsics are its own.
            up: The world's z axis in the base frame at the exposure, shape (3,).
            base_height: Of the base above the ground [m], roughly.
        """
        lens = intrinsics_of(frame)
        if lens != self._lens:
            rays, self._step = _rays(lens)
            # In the base frame, for each metre of depth. Each axis lies in one piece, here and in
            # all that is made of it: numpy adds and compares so in a sixth of the time
            self._lens, self._looks = lens, self._rotation @ rays.T
        looks, step = self._looks, self._step
        raw = frame.depth[step // 2 :: step, step // 2 :: step].reshape(-1)
        depth = raw.astype(np.float32) * np.float32(frame.depth_unit_m)
        valid = (raw > 0) & (raw < NOTHING)
        if self._range_m is not None:
            valid &= (depth >= self._range_m[0]) & (depth <= self._range_m[1])
        fall = up.astype(np.float32) @ looks
        near = fall * REACH_M < -(base_height + float(self.position @ up))
        number = np.count_nonzero(near)
        missing = np.count_nonzero(near & (raw == 0)) / number if number >= FEWEST else 0.0
        kept = np.flatnonzero(valid)
        points = looks.take(kept, axis=1) * depth[kept] + self.position[:, None]
        return ImagePoints(points.T, depth[kept], missing)


def read_lens(lens: Intrinsics) -> Intrinsics:
    """The pixels that are read of an image, as an image of their own: all of it is read."""
    step = _reading_step(lens)
    if step == 1:
        return lens
    # The centre of its first pixel is that of pixel step // 2
    first = step // 2 + 0.5
    return Intrinsics(
        width=len(range(step // 2, lens.width, step)),
        height=len(range(step // 2, lens.height, step)),
        fx=lens.fx / step, fy=lens.fy / step,
        cx=(lens.cx - first) / step + 0.5, cy=(lens.cy - first) / step + 0.5,
    )  # fmt: skip


def _reading_step(lens: Intrinsics) -> int:
    """Every which pixel is read, down and across."""
    return max(1, round((lens.width * lens.height / PIXELS) ** 0.5))


def _rays(lens: Intrinsics) -> tuple[Singles, int]:
    """Rays of the pixels that are read, with 1 along the optical axis,
    shape (n, 3); and every which pixel that is.
    """
    step = _reading_step(lens)
    u, v = (np.arange(step // 2, size, step) + 0.5 for size in (lens.width, lens.height))
    x, y = np.meshgrid((u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy)
    return np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3).astype(np.float32), step
