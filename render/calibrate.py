"""Where a camera really sits on a robot, from a recording in
which the robot stands on level, free ground.

The IMU says how the trunk is turned and the legs say how high it is; so the ground is known in the
base frame, and the camera's pitch, roll and height are those with which its points lie on it. The
camera's place ahead and to the side do not show on a plane; they stay as claimed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from saltus.arrays import Floats, Reals
from saltus.config import TomlValue
from saltus.depth import BASELINE_M, NOTHING, intrinsics_of
from saltus.depth_camera import DepthCamera
from saltus.errors import RecordingError
from saltus.recordings.recording import read_recording
from saltus.render.camera import ray_directions
from saltus.render.stereo.camera import StereoConfig
from saltus.robots.mount import Mount
from saltus.robots.robot import Robot
from saltus.rotations import rotation_matrix
from saltus.states import is_still
from saltus.wire.messages import ControllerMode, DepthFrame, RobotState

STANDING = (ControllerMode.STAND, ControllerMode.STOPPED)
FEWEST_FRAMES, MOST_FRAMES = 10, 60
"""0.2 s of a D435i, in which its noise becomes other noise seven times.

More than a second adds little.
"""
LEAST_SLOPE = 0.02  # of a ray, by which it comes down: flatter ones meet the ground beyond 10 m
EVERY_PIXEL = (
    4  # along rows and columns: neighbours share their noise, which is correlated over 9 pixels
)
RANGE_M = (0.25, 3.0)
"""Nearer are the robot's feet, farther the noise of stereo matching is 7 cm."""
SIGMA_PX, FLOOR_M = float(StereoConfig().disparity_noise.sigma), 0.002
"""Noise of a D435i's disparity; of ground that is swept and level, and of how well legs tell it."""
PITCHES, HEIGHTS_M = np.deg2rad(np.arange(-12.0, 12.1, 0.5)), np.arange(-0.08, 0.081, 0.01)
"""Off the claimed place, to begin with."""
GATES_M = (0.05, 0.04, 0.03, 0.03, 0.03, 0.03)
"""Points farther off the ground than this are no ground, in one round of the fit after the
other."""
HUBER = 2.0  # in units of the noise: beyond, a point counts less
LEAST_ON_GROUND = 0.6
"""Share of the points that must lie on the ground: of level ground 0.9, as flying pixels and feet
do not."""
BLOCKS = 8
"""Parts of the recording that are fitted by themselves; their spread gives the intervals."""


@dataclass(frozen=True, kw_only=True)
class CameraPlace(TomlValue):
    """Place of a camera on the trunk, as a calibration finds it."""

    pitch: float
    """Nose down positive [rad]."""
    roll: float
    """Roll of the image, right side down positive [rad]."""
    height: float
    """Height of the optical centre over the base's origin [m], base frame."""

    @property
    def numbers(self) -> Floats:
        """Pitch, roll and height, shape (3,)."""
        return np.array(list(vars(self).values()))

    def by(self, change: Reals) -> "CameraPlace":
        """The place with pitch, roll and height changed by so much, shape (3,)."""
        return CameraPlace(**dict(zip(vars(self), (self.numbers + change).tolist(), strict=True)))


NOWHERE = CameraPlace(pitch=0.0, roll=0.0, height=0.0)
STEP = 1e-6  # of pitch and roll [rad] and of height [m], for derivatives


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraCalibration:
    """Place of the camera that took a recording."""

    claimed: CameraPlace
    found: CameraPlace
    half_width_90: CameraPlace
    """Half of the 90 % interval of each, from the scatter of the recording's parts.

    Not what IMU and legs are off.
    """
    on_ground: float
    """Share of the points that lie on the ground."""
    frames: int
    camera: DepthCamera
    """The recording's, where it was found."""
    points_claimed: Floats
    points_found: Floats
    """Points ahead of the base and over the ground [m], shape (n, 2), as the claimed place has
    them, and the found."""


def calibrate_camera(path: Path) -> CameraCalibration:
    """Reads a recording (.mcap) of a robot that stands.

    Raises:
        RecordingError: it cannot be read, the robot hardly stands in it, or what lies ahead is no
            level, free ground.
    """
    recording = read_recording(path)
    pairs = standing_pairs(recording.of(DepthFrame), recording.of(RobotState))
    if len(pairs) < FEWEST_FRAMES:
        raise RecordingError(
            f"{path}: {len(pairs)} images of a robot that stands: it must stand for at least "
            f"{FEWEST_FRAMES} of them, "
            "on level ground with nothing ahead"
        )
    try:
        return fit_place(pairs, recording.robot, recording.camera)
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from error


def standing_pairs(
    frames: Sequence[DepthFrame], states: Sequence[RobotState]
) -> list[tuple[DepthFrame, RobotState]]:
    """Images with the state at which each was taken, where the robot stood."""
    times = np.array([state.time_ns for state in states], dtype=np.int64)
    pairs = []
    for frame in frames if len(states) else ():
        state = states[int(np.abs(times - frame.time_ns).argmin())]
        if abs(state.time_ns - frame.time_ns) <= 10_000_000 and stands_on_all_feet(state):
            pairs.append((frame, state))
    return pairs


def stands_on_all_feet(state: RobotState) -> bool:
    """True where a robot stands on all feet.

    By its rest where nobody says which feet stand, as in ROS.
    """
    if any(state.leg_trusted):
        return all(state.leg_trusted) and state.mode in STANDING
    return is_still(state.velocity_base_in_world, state.angular_velocity_base)


def fit_place(
    pairs: Sequence[tuple[DepthFrame, RobotState]], robot: Robot, camera: DepthCamera
) -> CameraCalibration:
    """The camera's place by images and states of one robot, which claims the place that it has.

    Raises:
        RecordingError: what the camera sees is no level ground.
    """
    chosen = [pairs[int(i)] for i in np.unique(np.linspace(0, len(pairs) - 1, MOST_FRAMES).round())]
    views = [SeenPoints.of(frame, state, robot) for frame, state in chosen]
    claimed = CameraPlace(
        pitch=float(robot.camera_pitch),
        roll=float(robot.camera_roll),
        height=float(robot.camera_position[2]),
    )
    everything = SeenPoints.joined(views)
    found = _fit(everything, _begin(everything, claimed))
    depth, sigma = everything.expected(found)
    near = np.abs(everything.over_ground(found)) < 4.0 * sigma
    looked_at = in_range(depth)
    on_ground = float(np.mean(near[looked_at])) if looked_at.any() else 0.0
    if on_ground < LEAST_ON_GROUND:
        raise RecordingError(
            f"{100 * on_ground:.0f} % of what the camera sees lies on the ground under the feet: "
            "it must be "
            f"{100 * LEAST_ON_GROUND:.0f} %, so let the robot stand on level ground with nothing "
            "ahead"
        )
    blocks = np.array_split(np.arange(len(views)), min(BLOCKS, len(views)))
    parts = [_fit(SeenPoints.joined([views[i] for i in block]), found) for block in blocks]
    spread = interval_90(np.array([part.numbers for part in parts]))
    position = (float(robot.camera_position[0]), float(robot.camera_position[1]), found.height)
    return CameraCalibration(
        claimed=claimed,
        found=found,
        half_width_90=NOWHERE.by(spread),
        on_ground=on_ground,
        frames=len(views),
        camera=replace(
            camera,
            name="calibrated",
            camera_position=position,
            camera_pitch=found.pitch,
            camera_roll=found.roll,
        ),
        points_claimed=everything.profile(claimed)[looked_at],
        points_found=everything.profile(found)[looked_at],
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class SeenPoints:
    """Points of the ground that a camera sees, for any number of images."""

    points: Floats
    """Camera frame [m], shape (n, 3)."""
    up: Floats
    """Away from the ground, base frame, shape (n, 3)."""
    base_height: Floats
    """[m], shape (n,)."""
    focal_px: float
    position: Floats
    """Claimed place of the camera [m], shape (3,)."""
    yaw: float
    """Claimed, as level ground does not tell it [rad]."""

    @classmethod
    def of(cls, frame: DepthFrame, state: RobotState, robot: Robot) -> "SeenPoints":
        """Points of one image, with the state at which it was taken."""
        rays = ray_directions(intrinsics_of(frame))[::EVERY_PIXEL, ::EVERY_PIXEL]
        raw = frame.depth[::EVERY_PIXEL, ::EVERY_PIXEL]
        seen = (raw > 0) & (raw < NOTHING)
        points = (rays * (raw * frame.depth_unit_m)[..., None])[seen]
        up = rotation_matrix(np.asarray(state.quaternion_base_in_world))[2]
        return cls(
            points=points, up=np.broadcast_to(up, points.shape), focal_px=frame.fx,
            base_height=np.full(len(points), state.base_height),
            position=np.asarray(robot.camera_position),
            yaw=robot.camera_yaw,
        )  # fmt: skip

    @classmethod
    def joined(cls, views: "Sequence[SeenPoints]") -> "SeenPoints":
        """Points of all views."""
        return cls(
            points=np.concatenate([view.points for view in views]),
            up=np.concatenate([view.up for view in views]),
            base_height=np.concatenate([view.base_height for view in views]),
            focal_px=views[0].focal_px,
            position=views[0].position,
            yaw=views[0].yaw,
        )

    def in_base(self, place: CameraPlace) -> Floats:
        """Points in the base frame, shape (n, 3)."""
        position = np.array([*self.position[:2], place.height])
        mount = Mount(position=position, pitch=place.pitch, roll=place.roll, yaw=self.yaw)
        return self.points @ mount.rotation.T + mount.position

    def over_ground(self, place: CameraPlace) -> Floats:
        """How high points lie over the ground [m], shape (n,)."""
        return np.einsum("ij,ij->i", self.up, self.in_base(place)) + self.base_height

    def expected(self, place: CameraPlace) -> tuple[Floats, Floats]:
        """Depth at which each ray meets the ground, infinite where it does not,
        and the noise of heights there [m].

        By these, not by what was measured, points are chosen and weighed: else noise would choose.
        """
        position = np.array([*self.position[:2], place.height])
        slope = np.einsum("ij,ij->i", self.up, self.in_base(place) - position) / self.points[:, 2]
        above = self.up @ position + self.base_height
        depth = np.where(slope < -LEAST_SLOPE, above / np.maximum(-slope, LEAST_SLOPE), np.inf)
        near = np.minimum(depth, RANGE_M[1])
        return depth, np.hypot(
            SIGMA_PX * near**2 / (self.focal_px * BASELINE_M) * np.abs(slope), FLOOR_M
        )

    def profile(self, place: CameraPlace) -> Floats:
        """Points ahead and over the ground [m], shape (n, 2)."""
        return np.stack([self.in_base(place)[:, 0], self.over_ground(place)], axis=-1)


def _begin(view: SeenPoints, claimed: CameraPlace) -> CameraPlace:
    """Place with the most points on the ground, of many about the claimed one."""
    few = replace(
        view, points=view.points[::20], up=view.up[::20], base_height=view.base_height[::20]
    )
    places = [
        claimed.by(np.array([pitch, 0.0, height])) for pitch in PITCHES for height in HEIGHTS_M
    ]
    return max(
        places, key=lambda place: int((np.abs(few.over_ground(place)) < 0.5 * GATES_M[0]).sum())
    )


def _fit(view: SeenPoints, place: CameraPlace) -> CameraPlace:
    """Gauss and Newton with Huber's weights; points off the ground do not count."""
    for gate in GATES_M:
        error, (depth, sigma) = view.over_ground(place), view.expected(place)
        counts = (np.abs(error) < gate) & in_range(depth)
        # Slopes where the ground is expected: those of measured points have noise that goes with
        # the error's
        ground = replace(
            view, points=view.points * np.where(counts, depth / view.points[:, 2], 1.0)[:, None]
        )
        here = ground.over_ground(place)
        slopes = np.stack(
            [(ground.over_ground(near) - here) / STEP for near in map(place.by, STEP * np.eye(3))],
            axis=-1,
        )
        weight = (
            counts * np.minimum(1.0, HUBER * sigma / np.maximum(np.abs(error), 1e-9)) / sigma**2
        )
        normal = (slopes * weight[:, None]).T @ slopes + 1e-9 * np.eye(3)
        place = place.by(-np.linalg.solve(normal, (slopes * weight[:, None]).T @ error))
    return place


def interval_90(parts: Floats) -> Floats:
    """Half of the 90 % interval of a mean, by the values of the parts, shape (n, ...)."""
    spread = np.std(parts, axis=0, ddof=1) / np.sqrt(len(parts))
    return np.asarray(float(stdtrit(len(parts) - 1, 0.95)) * spread)


def in_range(depth: Floats) -> NDArray[np.bool_]:
    """True where ground at this depth [m] counts."""
    return (depth > RANGE_M[0]) & (depth < RANGE_M[1])
