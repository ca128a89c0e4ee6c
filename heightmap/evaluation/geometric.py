"""The geometric baseline: heights by deprojection alone,
without training, on the best data that the robot has.

Every valid pixel of the last two seconds becomes a point in the robot's own odometry, with the pose
estimated at the frame's capture time. A height is the mean of the points at its place, weighted by
the variance of depth and the drift since. Points on walls are left out: heights are of what can be
stood on. Where no point is, the nearest one stands in.

With a `foot_gain` the map also moves up and down until the standing feet touch it: a second,
stronger baseline.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saltus import rotations
from saltus.arrays import Floats
from saltus.depth import NOTHING, RANGE_M, intrinsics_of
from saltus.grid import HeightGrid
from saltus.heightmap.evaluation.odometry import OdometryPose, VelocityOdometry
from saltus.heightmap.service.quantiles import INTERVAL90, UNKNOWN_HALF_WIDTH_M
from saltus.render.camera import camera_pose, ray_directions
from saltus.robots.legs import LegKinematics
from saltus.robots.mount import Mount
from saltus.robots.robot import Robot
from saltus.wire.messages import DepthFrame, Heightmap, HeightmapStatus, RobotState
from saltus.wire.topics import TOPICS

MODEL_ID = "geometric"
FOOT_GAIN = 0.3
"""Share of the distance between feet and map that one tick removes: the best of 0.05, 0.15, 0.3 on
recorded runs."""
FOOT_GATE_M = 0.06  # what is more is an edge beside the foot, not drift
# At 0.6 m/s and above, everything between the first view and the last point behind the robot
MEMORY_S = 2.0
BASELINE_M = 0.050  # of the imagers; D435i datasheet
DISPARITY_STD_PX = 0.08  # D435i datasheet, "sub-pixel RMS error" of a good calibration
# Of the D435i at 424 x 240; a pooled image does not lessen errors that neighbours share
SENSOR_FOCAL_PX = 211.313
DRIFT_MPS = 0.10
"""Drift of the odometry: 5 cm down and 9 cm back in 1 s in recorded runs on stairs, step and
gap."""
HALF_WIDTH_M = 0.15  # points as far to the side count: legs are 0.13 m from the middle
BIN_M = 0.01
# Half of it, around each point of the grid: a pixel at 0.7 m covers 1 cm (D435i), 5 cm (pooled)
WINDOW_M = 0.0125
WALL_ANGLE = math.radians(45.0)  # steeper than this nothing can be stood on
# Half the angle over which steepness is judged [rad]: wide against noise, narrow against a stair
WALL_SPAN = 0.014
OUTLIER_SIGMAS = 3.0
SLACK_M = 0.01  # what the drift since the last view may add to the noise of a point
# Standard error per distance to the nearest known point: terrains rise 0.2 m over 0.25-0.5 m
GAP_SLOPE = 0.5

_DEPTH = TOPICS["camera/depth"]


@dataclass(frozen=True, eq=False)
class _Points:
    """Contribution of one frame: means of its pixels over bins along the heading,
    in the odometry's world.
    """

    time_ns: int
    xyz: Floats
    """[m], shape (n, 3)."""
    variance: Floats
    """Variance of the height [m^2], shape (n,)."""


class GeometricHeightmap:
    """Heights by deprojecting images with the robot's odometry, without a network.

    `step` is as that of `saltus.heightmap.service.service.HeightmapService`.

    A frame counts for `memory_s`, where `images` is given only as one of the newest so many;
    `foot_gain` is the share of the mean distance between standing feet and map that one tick
    removes.
    """

    def __init__(
        self,
        robot: Robot,
        grid: HeightGrid,
        memory_s: float = MEMORY_S,
        foot_gain: float = 0.0,
        images: int | None = None,
    ) -> None:
        self._x, self._foot_gain = grid.points[:, 0], foot_gain
        self._mount, self._legs, self._foot_radius = (
            Mount.of(robot),
            LegKinematics(robot),
            robot.foot_radius,
        )
        self._memory_ns = round(1e9 * memory_s)
        self._odometry = VelocityOdometry(memory_s)
        self._points: deque[_Points] = deque(maxlen=images)
        self._newest: DepthFrame | None = None
        self._last: Heightmap | None = None

    def step(self, state: RobotState, frame: DepthFrame | None, now_ns: int) -> Heightmap:
        """Advances by one tick; see there."""
        if self._last is not None and state.step <= self._last.step:
            return self._last
        if not self._odometry.advance(state):
            self._points.clear()
        if frame is not None and (self._newest is None or frame.time_ns > self._newest.time_ns):
            self._take(frame)
        while self._points and state.time_ns - self._points[0].time_ns > self._memory_ns:
            self._points.popleft()
        height, half_width_90 = self._fuse(self._odometry.pose)
        if self._foot_gain > 0.0 and self._points:
            height = height + self._touch(state, height)
        newest = self._newest
        self._last = Heightmap(
            time_ns=state.time_ns,
            step=state.step,
            x=self._x,
            height=height,
            half_width_90=half_width_90,
            status=self._status(now_ns),
            depth_age_s=math.inf if newest is None else (state.time_ns - newest.time_ns) * 1e-9,
            frame_id=-1 if newest is None else newest.frame_id,
            model_id=MODEL_ID,
        )
        return self._last

    def _take(self, frame: DepthFrame) -> None:
        self._newest = frame
        pose = self._odometry.pose_at(frame.time_ns)
        if pose is None:
            return
        points = _points_of(frame, pose, self._mount)
        if len(points.xyz):
            self._points.append(points)

    def _touch(self, state: RobotState, height: Floats) -> float:
        """Moves the map towards the feet that stand; returns by how much [m]."""
        rotation = rotations.rotation_matrix(self._odometry.pose.quaternion)
        yaw_from_world = rotations.yaw_rotation(np.asarray(self._odometry.pose.yaw)).T
        feet = (
            self._legs.position(np.asarray(state.joint_position, np.float64))
            @ (yaw_from_world @ rotation).T
        )
        gap = feet[:, 2] - self._foot_radius - np.interp(feet[:, 0], self._x, height)
        drift = gap[np.asarray(state.leg_trusted) & (np.abs(gap) < FOOT_GATE_M)]
        if not len(drift):
            return 0.0
        shift = self._foot_gain * float(drift.mean())
        for points in self._points:
            points.xyz[:, 2] += shift
        return shift

    def _status(self, now_ns: int) -> HeightmapStatus:
        if self._newest is None or not self._points:
            return HeightmapStatus.WARMING
        age_s = (now_ns - self._newest.time_ns) * 1e-9
        if age_s > _DEPTH.invalid_age_s:
            return HeightmapStatus.INVALID
        return HeightmapStatus.DEGRADED if age_s > _DEPTH.degraded_age_s else HeightmapStatus.OK

    def _fuse(self, pose: OdometryPose) -> tuple[Floats, Floats]:
        """Heights relative to the base and half of their 90 % intervals, each of shape (30,)."""
        if not self._points:
            unknown = np.zeros(len(self._x))
            return unknown, unknown + UNKNOWN_HALF_WIDTH_M
        drift = [(DRIFT_MPS * (pose.time_ns - p.time_ns) * 1e-9) ** 2 for p in self._points]
        offset = np.concatenate([p.xyz for p in self._points]) - pose.position
        variance = np.concatenate([p.variance for p in self._points])
        variance += np.repeat(drift, [len(p.variance) for p in self._points])
        ahead = math.cos(pose.yaw) * offset[:, 0] + math.sin(pose.yaw) * offset[:, 1]
        order = np.argsort(ahead)
        return _on_grid(self._x, ahead[order], offset[order, 2], variance[order])


def _points_of(frame: DepthFrame, pose: OdometryPose, mount: Mount) -> _Points:
    """Deprojects a frame, leaves out walls, and averages over bins along the heading."""
    camera = intrinsics_of(frame)
    depth = frame.depth * frame.depth_unit_m
    seen = (frame.depth > 0) & (frame.depth < NOTHING) & (depth < RANGE_M)
    origin, rotation = camera_pose(mount, pose.position, pose.quaternion)
    rays = ray_directions(camera) @ np.asarray(rotation).T  # (height, width, 3) in the world
    points = np.asarray(origin) + depth[..., None] * rays
    offset = points - pose.position
    cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
    ahead = cos * offset[..., 0] + sin * offset[..., 1]
    aside = cos * offset[..., 1] - sin * offset[..., 0]
    used = seen & (np.abs(aside) < HALF_WIDTH_M) & ~_walls(ahead, points[..., 2], seen, camera.fy)
    depth_std = depth**2 * DISPARITY_STD_PX / (SENSOR_FOCAL_PX * BASELINE_M)
    variance = (depth_std * rays[..., 2]) ** 2
    return _binned(frame.time_ns, points[used], variance[used], ahead[used])


def _walls(ahead: Floats, z: Floats, seen: NDArray[np.bool_], focal: float) -> NDArray[np.bool_]:
    """Pixels that lie on a wall: between their neighbours above and below,
    height changes more than distance does.
    """
    k = max(1, round(WALL_SPAN * focal))
    up, down = np.arange(len(z)) - k, np.arange(len(z)) + k
    up, down = np.maximum(up, 0), np.minimum(down, len(z) - 1)
    rise, run = np.abs(z[up] - z[down]), np.abs(ahead[up] - ahead[down])
    wall: NDArray[np.bool_] = seen[up] & seen[down] & (rise > math.tan(WALL_ANGLE) * run)
    return wall


def _binned(time_ns: int, points: Floats, variance: Floats, ahead: Floats) -> _Points:
    """Weighted means.

    Errors of neighbours are shared, so a mean is no surer than the surest pixel in it.
    """
    place, index = np.unique(np.floor(ahead / BIN_M).astype(np.int64), return_inverse=True)
    weight = 1.0 / np.maximum(variance, 1e-8)
    total = np.bincount(index, weight, len(place))
    mean = [np.bincount(index, weight * points[:, axis], len(place)) / total for axis in range(3)]
    surest = np.full(len(place), np.inf)
    np.minimum.at(surest, index, variance)
    return _Points(time_ns, np.stack(mean, axis=-1).reshape(-1, 3), surest)


def _on_grid(line_x: Floats, ahead: Floats, z: Floats, variance: Floats) -> tuple[Floats, Floats]:
    """Fuses points, sorted by distance ahead, at each place of the grid.

    Where none is near, those around the nearest one count.
    """
    first, last = _window(ahead, line_x)
    right = np.minimum(np.searchsorted(ahead, line_x), len(ahead) - 1)
    left = np.maximum(right - 1, 0)
    nearest = ahead[np.where(line_x - ahead[left] <= ahead[right] - line_x, left, right)]
    place = np.where(first == last, nearest, line_x)
    first, last = _window(ahead, place)
    index = first[:, None] + np.arange(int(np.max(last - first)))
    within = index < last[:, None]
    index = np.minimum(index, len(ahead) - 1)
    height, fused = _robust_means(z[index], variance[index], within)
    half_width_90 = INTERVAL90 * np.hypot(fused, GAP_SLOPE * np.abs(place - line_x))
    return height, np.minimum(half_width_90, UNKNOWN_HALF_WIDTH_M)


def _window(ahead: Floats, place: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and end of the points near each place."""
    return np.searchsorted(ahead, place - WINDOW_M), np.searchsorted(ahead, place + WINDOW_M)


def _robust_means(z: Floats, variance: Floats, within: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Means of the points that agree with the weighted median, and their standard errors.

    The median chooses one side of an edge. The surest point bounds the standard error from below:
    points share the drift of the odometry, so that more of them do not make the mean surer. Arrays
    have the shape (places, points); those that are not `within` do not count.
    """
    weight = np.where(within, 1.0 / np.maximum(variance, 1e-8), 0.0)
    order = np.argsort(np.where(within, z, np.inf), axis=1)
    share = np.cumsum(np.take_along_axis(weight, order, axis=1), axis=1)
    middle = np.count_nonzero(share < 0.5 * share[:, -1:], axis=1)[:, None]
    median = np.take_along_axis(z, np.take_along_axis(order, middle, axis=1), axis=1)
    agrees = within & (np.abs(z - median) <= OUTLIER_SIGMAS * np.sqrt(variance) + SLACK_M)
    chosen = weight * agrees
    mean = np.sum(chosen * z, axis=1) / np.sum(chosen, axis=1)
    return mean, np.sqrt(np.min(np.where(agrees, variance, np.inf), axis=1))
