"""Where the camera of a run log was and where it looked,
by its claims and poses, and what there was to see.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import Akima1DInterpolator
from scipy.signal import savgol_coeffs, savgol_filter
from scipy.stats import median_abs_deviation

from saltus.arrays import Floats, Indices
from saltus.real2sim.problem.log import boxes_of, robot_of
from saltus.real2sim.problem.quaternions import continuous_quaternions, normalise_quaternions
from saltus.recordings.run_claims import CameraClaim
from saltus.recordings.run_log import RunLog
from saltus.robots.mount import Mount
from saltus.rotations import rotation_matrix
from saltus.terrain.boxes import Boxes

SMOOTHING_S = (
    0.06  # a body that keeps its feet on the ground does not change its acceleration faster
)
# Times the noise: smoothing takes away more than noise from the motion of a robot that lands
ROUGH = 6.0
SMOOTHING_ORDER = 3
FARTHEST_M = 65.535  # what a run log can hold: the sky is no hole in an image
LEAST_NOISE = 1e-4  # m and rad: no motion capture of a walking robot is better


@dataclass(frozen=True, kw_only=True, eq=False)
class ClaimedCamera:
    """Camera as `meta.json` claims it."""

    fx: float
    fy: float
    cx: float
    cy: float
    mount: Mount
    latency_s: float
    range_m: float
    """Farthest depth; things beyond read as this far, or as nothing."""

    def tangents(self, row: Indices, column: Indices) -> Floats:
        """Where pixels look, camera frame (right, down, forward), of depth 1.

        Shapes (n,) -> (3, n).
        """
        x, y = (column + 0.5 - self.cx) / self.fx, (row + 0.5 - self.cy) / self.fy
        return np.stack([x, y, np.ones_like(x)])


def claimed_camera(log: RunLog) -> ClaimedCamera:
    """Reads the camera that a log claims."""
    camera = log.meta["camera"]
    return ClaimedCamera(
        **{name: float(camera[name]) for name in ("fx", "fy", "cx", "cy")},
        mount=claimed_mount(camera),
        latency_s=float(camera.get("latency", 0.0)),
        range_m=min(float(camera.get("range_max") or math.inf), FARTHEST_M),
    )


def claimed_mount(camera: CameraClaim) -> Mount:
    """Where a camera sits by its claim (`meta.camera`); angles that are not claimed are 0."""
    angles = {
        "roll": float(camera.get("roll", 0.0)),
        "pitch": float(camera.get("pitch", 0.0)),
        "yaw": float(camera.get("yaw", 0.0)),
    }
    return Mount(position=np.asarray(camera["position"], dtype=np.float64), **angles)


class BaseMotion:
    """The measured pose of the base at any time:
    smoothed but for landings, then cubic interpolation.

    An error of the pose moves all pixels of an image at once: half a milliradian shifts the ground
    at 1.5 m by more than its noise. Akima's interpolation does not swing about a base that is moved
    by hand from one rest to the next. Without `base.csv` the base stands still at the height of a
    standing robot.
    """

    def __init__(self, log: RunLog) -> None:
        self.start_s, self.end_s = -math.inf, math.inf
        self._spline: Akima1DInterpolator | None = None
        self.noise_m = self.noise_rad = LEAST_NOISE
        """Standard deviation of what `at` returns, per axis [m] and [rad]."""
        if log.base is None or not len(log.base.time_s):
            self._pose = np.array([0.0, 0.0, robot_of(log).stand_height, 1.0, 0.0, 0.0, 0.0])
            return
        time_s, first = np.unique(log.base.time_s, return_index=True)
        pose = log.base.values[first, :7].copy()
        # q and -q are one rotation: a spline must not run from one to the other
        pose[:, 3:] = continuous_quaternions(pose[:, 3:])
        self._pose = np.median(pose, axis=0)
        if len(time_s) >= 4:
            self.start_s, self.end_s = float(time_s[0]), float(time_s[-1])
            smooth, left = _smoothed(time_s, pose)
            # a rotation by a small angle is half of it in the quaternion
            taken = (pose - smooth) * np.array([1.0] * 3 + [2.0] * 4)
            spread = [max(_spread(part), LEAST_NOISE) for part in (taken[:, :3], taken[:, 3:])]
            if np.any(np.abs(taken) > ROUGH * np.repeat(spread, [3, 4])):
                smooth, left = pose, math.hypot(1.0, left)
            self._spline = Akima1DInterpolator(time_s, smooth)
            self.noise_m, self.noise_rad = (max(left * each, LEAST_NOISE) for each in spread)

    def at(self, time_s: Floats) -> tuple[Floats, Floats]:
        """Position [m], shape (n, 3), and rotation from base to world,
        shape (n, 3, 3); ends are held.
        """
        if self._spline is None:
            pose = np.broadcast_to(self._pose, (len(time_s), 7))
        else:
            pose = self._spline(np.clip(time_s, self.start_s, self.end_s))
        return pose[:, :3], rotation_matrix(normalise_quaternions(pose[:, 3:]))


def _smoothed(time_s: Floats, pose: Floats) -> tuple[Floats, float]:
    """Cubic least squares over `SMOOTHING_S` about each sample,
    shape (n, 7), where a log is sampled that densely.

    Also returns what is left of white noise, over what was taken away. A stretch ends where samples
    are missing: the robot may have been carried elsewhere.
    """
    gaps = np.diff(time_s)
    window = 2 * round(0.5 * SMOOTHING_S / float(np.median(gaps))) + 1
    if window <= SMOOTHING_ORDER + 1:
        return pose, 0.0
    smooth = pose.copy()
    for part in np.split(np.arange(len(time_s)), np.flatnonzero(gaps > SMOOTHING_S) + 1):
        if len(part) > window:
            smooth[part] = savgol_filter(pose[part], window, SMOOTHING_ORDER, axis=0)
    # of least squares, the weight of a sample in its own estimate is the share of the variance that
    # stays
    own = float(savgol_coeffs(window, SMOOTHING_ORDER)[window // 2])
    return smooth, math.sqrt(own / (1.0 - own))


def _spread(values: Floats) -> float:
    """Standard deviation without outliers, of the axis that has most."""
    return float(np.max(median_abs_deviation(values, axis=0, scale="normal")))


NEAREST_M = 1e-3  # what is nearer to the image plane is behind the lens


@dataclass(frozen=True, kw_only=True, eq=False)
class VisibleScene:
    """Things that can be seen, in the world frame."""

    box_low: Floats
    """Lowest corner of each box [m], shape (boxes, 3)."""
    box_high: Floats
    """Highest corner [m], shape (boxes, 3)."""
    has_ground: bool
    """True where there is a plane z = 0."""

    def depth(self, origin: Floats, direction: Floats) -> Floats:
        """Along each ray in lengths of its direction, infinite where nothing is hit.

        Args:
            origin: of the rays [m], world frame, shape (n, 3).
            direction: world frame, shape (n, 3, rays); of depth 1, so that the result is depth
                along the optical axis.

        Returns:
            Shape (n, rays).
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1.0 / direction
            nearest = np.full((len(origin), direction.shape[2]), np.inf)
            if self.has_ground:
                ground = -origin[:, 2:] * inverse[:, 2]
                nearest = np.where(ground > NEAREST_M, ground, np.inf)
            for low, high in zip(self.box_low, self.box_high, strict=True):
                first, last = _slab(origin, inverse, low, high)
                np.copyto(
                    nearest, first, where=(first <= last) & (first > NEAREST_M) & (first < nearest)
                )
        return nearest


def _slab(origin: Floats, inverse: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Where rays enter and leave a box, shape (n, rays) each;
    entry is behind exit where they miss it.
    """
    first = last = np.empty(0)
    for axis in range(3):
        one = (low[axis] - origin[:, axis, None]) * inverse[:, axis]
        two = (high[axis] - origin[:, axis, None]) * inverse[:, axis]
        near, far = np.fmin(one, two), np.fmax(one, two)
        first = np.maximum(first, near) if axis else near
        last = np.minimum(last, far) if axis else far
    return first, last


def claimed_scenes(boxes: Boxes) -> tuple[VisibleScene, ...]:
    """Readings of what a log claims of its terrain, the likelier first.

    Without boxes it is the plane z = 0. Boxes may hold the ground as one of them, or may leave it
    out; which it is shows in the images.
    """
    low, high = boxes.center - boxes.half_size, boxes.center + boxes.half_size
    readings = (True, False) if len(low) else (True,)
    return tuple(VisibleScene(box_low=low, box_high=high, has_ground=ground) for ground in readings)


def expected_depth(poses: Floats, log: RunLog, rows: Indices, columns: Indices) -> Floats:
    """Depth that a log's camera would measure of its claimed terrain, along the optical axis.

    Args:
        poses: Position [m] and quaternion (w, x, y, z) of the base in the world, shape (n, 7).
        log: With claims about its camera and its terrain.
        rows: Pixels, shape (r,).
        columns: Pixels, shape (c,).

    Returns:
        Shape (n, r, c) [m]; infinite where a ray meets nothing.
    """
    camera, scene = claimed_camera(log), claimed_scenes(boxes_of(log))[0]
    row, column = np.meshgrid(rows, columns, indexing="ij")
    looks = camera.mount.rotation @ camera.tangents(row.ravel(), column.ravel())
    rotation = np.asarray(rotation_matrix(normalise_quaternions(poses[:, 3:])))
    depth = scene.depth(poses[:, :3] + rotation @ camera.mount.position, rotation @ looks)
    return depth.reshape(len(poses), len(rows), len(columns))
