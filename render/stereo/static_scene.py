"""Statistics of each pixel in a recording of a scene in which nothing moves."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from saltus.arrays import Reals
from saltus.depth import NOTHING
from saltus.errors import RecordingError
from saltus.render.stereo.edges import beside_disparity_edge
from saltus.render.stereo.optics import BASELINE_M
from saltus.wire.messages import DepthFrame


@dataclass(frozen=True, kw_only=True)
class StereoEstimate:
    """A parameter of a stereo camera's noise as a recording shows it, with how sure that is."""

    value: float | None = None
    """None where the recording cannot show it."""
    error: float | None = None
    """Standard error."""
    note: str = ""
    """The reason why it is untestable, or what the value rests on."""

    def __str__(self) -> str:
        value = "untestable" if self.value is None else f"{self.value:.4g} +- {self.error:.2g}"
        return f"{value:22} {self.note}".rstrip()

    @property
    def testable(self) -> bool:
        """True where there is a value."""
        return self.value is not None


def stereo_estimate(value: float, error: float, note: str = "") -> StereoEstimate:
    """A value with its standard error."""
    return StereoEstimate(value=float(value), error=float(error), note=note)


def untestable_estimate(reason: str) -> StereoEstimate:
    """An estimate without a value, and why."""
    return StereoEstimate(note=reason)


MOVED_PX = (
    1.0  # twelve times the noise of a D435i: a pixel that changes by more has seen something else
)
MOVED_SHARE = 0.1  # of the pixels, from one frame to the next: more than edges that flicker
EDGE_PX = 1.0  # as for the holes at edges
# Of the image: principal points lie within some 3 % of its middle; other modes' are farther off
OFF_CENTRE = 0.1
CLEAR_PX = 7  # beyond the reach of an edge's holes, and of the second difference that finds it


@dataclass(frozen=True, kw_only=True, eq=False)
class StaticScene:
    """Statistics over the longest part of a recording in which nothing moves.

    Inverse depth is proportional to disparity, whatever the baseline, so everything is measured in
    it.
    """

    inverse: NDArray[np.float32]
    """1 / depth [1/m], 0 where invalid, shape (frames, height, width)."""
    period_s: float
    """Between frames; 0 where there is one."""
    fx: float
    """Focal length [px]."""
    unit_m: float
    """Depth unit [m]."""
    median: NDArray[np.float32]
    """Median of the inverse depth of each pixel where it is valid, 0 where it never is, shape
    (height, width)."""
    presence: NDArray[np.float64]
    """Share of the frames in which a pixel is valid, shape (height, width)."""
    surface: NDArray[np.bool_]
    """Pixels that are always valid, away from every edge, shape (height, width)."""

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.inverse)

    @property
    def nominal(self) -> Reals:
        """Median as the disparity [px] that the datasheet's baseline would make of it,
        shape (height, width).
        """
        return self.median * (self.fx * BASELINE_M)


def static_scene(frames: Sequence[DepthFrame]) -> StaticScene:
    """Takes the longest part of a recording in which nothing moves.

    Raises:
        RecordingError: no frames, frames of different cameras or with intrinsics that are not
            theirs, or nothing valid.
    """
    if not frames:
        raise RecordingError("the recording holds no depth frames")
    first = frames[0]
    _check_camera(first)
    for frame in frames:
        if frame.depth.shape != first.depth.shape or (frame.fx, frame.depth_unit_m) != (
            first.fx,
            first.depth_unit_m,
        ):
            raise RecordingError(
                f"{_mode(frame)} does not match {_mode(first)}: fit one camera in one mode at a "
                "time"
            )
    raw = np.stack([frame.depth for frame in frames])
    valid = (raw > 0) & (raw < NOTHING)
    if not np.any(valid):
        raise RecordingError("no pixel of the recording is valid")
    depth = np.where(valid, raw, 1) * np.float32(first.depth_unit_m)
    inverse = np.where(valid, np.float32(1.0) / depth, np.float32(0.0))
    begin, end = _longest_rest(inverse, first.fx * BASELINE_M)
    times_s = 1e-9 * np.array([frame.time_ns for frame in frames[begin:end]])
    return _summarised(
        inverse[begin:end],
        float(np.median(np.diff(times_s))) if end - begin > 1 else 0.0,
        first.fx,
        first.depth_unit_m,
    )


def _check_camera(frame: DepthFrame) -> None:
    for name in ("fx", "fy", "depth_unit_m"):
        value = getattr(frame, name)
        if not (math.isfinite(value) and value > 0.0):
            raise RecordingError(
                f"{_mode(frame)}: {name} = {value} must be a finite number above 0"
            )
    height, width = frame.depth.shape
    for name, centre, size in (("cx", frame.cx, width), ("cy", frame.cy, height)):
        if not abs(centre - 0.5 * size) <= OFF_CENTRE * size:
            raise RecordingError(
                f"{_mode(frame)}: {name} = {centre:g} px is not near the middle of {size} px, so "
                "the intrinsics do not "
                "match the images: were they taken from another resolution?"
            )


def _mode(frame: DepthFrame) -> str:
    height, width = frame.depth.shape
    return (
        f"frame {frame.frame_id} ({width}x{height}, fx {frame.fx:.1f} px, unit "
        f"{frame.depth_unit_m:g} m)"
    )


def _longest_rest(inverse: NDArray[np.float32], nominal: float) -> tuple[int, int]:
    """First frame and end of the longest run in which at most a tenth of the pixels change."""
    best, begin = (0, 1), 0
    for k in range(1, len(inverse)):
        both = (inverse[k] > 0.0) & (inverse[k - 1] > 0.0)
        changed = np.abs(inverse[k] - inverse[k - 1])[both] * nominal > MOVED_PX
        if not changed.size or np.mean(changed) > MOVED_SHARE:
            begin = k
        best = max(best, (begin, k + 1), key=lambda run: run[1] - run[0])
    return best


def _summarised(
    inverse: NDArray[np.float32], period_s: float, fx: float, unit_m: float
) -> StaticScene:
    valid = inverse > 0.0
    count = np.sum(valid, axis=0)
    ordered = np.sort(inverse, axis=0)  # the invalid come first
    middle = len(inverse) - 1 - count // 2
    median = np.take_along_axis(ordered, np.clip(middle, 0, len(inverse) - 1)[None], axis=0)[0]
    presence = count / len(inverse)
    # an invalid pixel counts as an edge: what lies behind it is not known
    rough = beside_disparity_edge(median * np.float32(fx * BASELINE_M), EDGE_PX) | (presence < 0.5)
    near_edge = binary_dilation(rough, iterations=CLEAR_PX)
    return StaticScene(
        inverse=inverse,
        period_s=period_s,
        fx=fx,
        unit_m=unit_m,
        median=median,
        presence=presence,
        surface=(presence == 1.0) & ~near_edge,
    )
