"""A depth camera as one value: where it sits, what its images are,
when they come, and which errors they have.

`ideal`, `d435i` and `d435i_whole` are three of them; one's own is a TOML file
(examples/camera.toml) that names what differs from d435i.
"""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Array, Constant, namespace
from saltus.config import TomlValue, check_between, read_file, read_toml, with_changes
from saltus.depth import (
    BASELINE_M,
    D435I,
    MODEL_CAMERA,
    Intrinsics,
    model_image,
    supersampled_model_camera,
)
from saltus.effects.image_delivery import CameraLatency
from saltus.effects.profile import Profile
from saltus.errors import ConfigError, nearest_hint
from saltus.robots.robot import Robot

STEP_HZ = 100.0
"""Step of the plant, which says where a camera is."""
SLOWEST_HZ = 20.0
"""Images that are farther apart count as lost (`saltus.wire.topics`)."""
LONGEST_LATENCY_S = 0.1
"""Images that come later are too old to be used (`saltus.wire.topics`)."""
NATIVE_PIXELS = 5
"""Native pixels of a D435i at 424x240, in each direction, for one pixel of the model."""
DECIMATION = 6
"""Native pixels of a D435i, in each direction, for one pixel of `d435i_whole`: librealsense's
decimation filter takes 2 to 8, and drops what is left over. So all pixels are read by the scan,
which takes about as many of an image (`saltus.heightmap.scan.scan_camera.PIXELS`)."""
_ROUNDING = 1e-9
_TURN = (-math.pi, math.pi)
_LARGEST = 4096  # of an image's sides [px]
_VIEWS = ("image", "sensor")  # tables that are named as a whole


@dataclass(frozen=True, kw_only=True)
class DepthCamera(TomlValue):
    """A depth camera on a robot.

    Raises:
        ConfigError: a number that no camera has; the message names it.
    """

    name: str
    camera_position: tuple[float, float, float] | None = None
    """Optical centre in the base frame [m]; where the robot has its own, if None."""
    camera_pitch: float | None = None
    """Nose down positive [rad]; that of the robot's own, if None."""
    camera_roll: float | None = None
    """About the optical axis, right side down positive [rad]; that of the robot's own, if None."""
    camera_yaw: float | None = None
    """To the left positive [rad]; that of the robot's own, if None.

    The camera turns by yaw, then pitch, then roll.
    """
    mount_error: float = 1.0
    """Errors of this pose and of the images' scale, in units of those of a careful person's
    measurement (0.3 degrees, 3 mm, 0.8 %): 0 where they are known exactly, as in simulation. The
    network of the scan is told, and half-widths are as wide as that asks."""
    rate_hz: float = 50.0
    """Images a second: each is taken at the first of the plant's steps that is not before its
    time."""
    latency_s: float | None = None
    """From exposure to arrival, in place of the profile's `camera_latency` [s].

    That of the profile, if None.
    """
    range_m: tuple[float, float] | None = None
    """Nearest and farthest valid depth [m]; None if all is valid."""
    depth_unit_m: float | None = None
    """Metres that one step of the images of a real one is, for `saltus ros2`: 0.0001 of a D405,
    0.00025 of an L515; as ROS has it, if None. Simulated images are in millimetres."""
    ideal: bool = False
    """True depth: no errors of stereo matching."""
    baseline_m: float = BASELINE_M
    """Distance of the imagers [m]."""
    image: Intrinsics
    """The image that it sends."""
    sensor: Intrinsics | None = None
    """Pixels in which the imagers match, where the image is a part of them."""
    stereo: dict[str, dict[str, float]] = field(default_factory=dict)
    """Parameters of the errors that are not those of a D435i
    (`saltus.render.stereo.camera.StereoConfig`)."""

    def __post_init__(self) -> None:
        check_between(
            self, camera_position=(-10.0, 10.0), camera_pitch=_TURN, camera_roll=_TURN,
            camera_yaw=_TURN, mount_error=(0.0, 10.0), rate_hz=(SLOWEST_HZ, STEP_HZ),
            latency_s=(0.0, LONGEST_LATENCY_S), range_m=(0.0, 100.0), depth_unit_m=(1e-6, 1.0),
            baseline_m=(1e-3, 1.0),
        )  # fmt: skip
        for view in (self.image, self.matching):
            check_between(
                view, width=(1, _LARGEST), height=(1, _LARGEST), fx=(1.0, 1e5), fy=(1.0, 1e5)
            )
            check_between(view, cx=(-1e5, 1e5), cy=(-1e5, 1e5))
        if self.range_m is not None and not self.range_m[0] < self.range_m[1]:
            raise ConfigError(
                f"range_m = {list(self.range_m)}: the second must be more than the first"
            )

    @classmethod
    def from_toml(cls, text: str) -> Self:
        """Reads what `to_toml` writes, or a part of it: what is not named is as in d435i.

        An image, and likewise a sensor, is named as a whole: width, height, and fx and fy or
        fov_deg (two angles [deg]); cx and cy are its centre where they are not given.
        """
        return cast("Self", recorded_camera(read_toml(text)))

    @property
    def matching(self) -> Intrinsics:
        """Pixels in which the imagers match: those of the sensor, or else of the image."""
        return self.sensor or self.image

    @property
    def record(self) -> str | dict[str, Any]:
        """Its name where it is shipped, else all of it as plain values; `recorded_camera` reads
        it.
        """
        return self.name if SHIPPED.get(self.name) == self else read_toml(self.to_toml())

    @property
    def mount(self) -> dict[str, object]:
        """Its pose on the trunk, by the fields of `Robot`; None for what is the robot's own."""
        names = ("camera_position", "camera_pitch", "camera_roll", "camera_yaw")
        return {name: getattr(self, name) for name in names}

    def mounted_on(self, robot: Robot) -> Robot:
        """The robot with its camera where this one sits."""
        named: dict[str, Any] = {
            name: value for name, value in self.mount.items() if value is not None
        }
        return replace(robot, **named) if named else robot

    def delivered(self, profile: Profile) -> Profile:
        """The profile with this camera's latency, if it has one of its own."""
        if self.latency_s is None:
            return profile
        known = [effect for effect in profile.camera if isinstance(effect, CameraLatency)] or [
            CameraLatency()
        ]
        others = [effect for effect in profile.camera if not isinstance(effect, CameraLatency)]
        return replace(profile, camera=(*others, replace(known[0], latency=self.latency_s)))

    def taken_by(self, step: Array) -> Array:
        """How many images it has taken by a step of 10 ms, itself included.

        The first is taken at step 0.
        """
        return (
            np.floor(np.asarray(step) * (self.rate_hz / STEP_HZ) + _ROUNDING).astype(np.int64) + 1
        )

    def exposes(self, step: int) -> bool:
        """True where it takes an image at a step of 10 ms."""
        return bool(self.taken_by(step) > self.taken_by(step - 1))

    def exposures(self, steps: int) -> NDArray[np.int32]:
        """Steps of 10 ms, of the first `steps` ones, at which it takes an image, ascending."""
        taken = self.taken_by(np.arange(-1, steps))
        return np.flatnonzero(np.diff(taken)).astype(np.int32)

    def in_range(self, depth: Array) -> Array:
        """Depth [m] of any shape and library, 0 (invalid) where this camera measures none."""
        if self.range_m is None:
            return depth
        near, far = self.range_m
        return namespace(depth).where((depth >= near) & (depth <= far), depth, 0.0)

    def masked(self, depth: Array) -> Array:
        """Depth in the view of the model's camera [m],
        0 where this camera does not look or measure.

        Shape (..., 48 k, 16 m), with k and m samples for each pixel of the model, in and out.
        """
        depth = self.in_range(depth)
        if self._covered is None:
            return depth
        xp, covered = namespace(depth), self._covered.like(depth) > 0.0
        for axis in (0, 1):
            covered = xp.repeat(covered, depth.shape[axis - 2] // covered.shape[axis], axis=axis)
        return xp.where(covered, depth, 0.0)

    @cached_property
    def _covered(self) -> Constant | None:
        """1 where an image of this camera gives a pixel of the model's,
        else 0, shape (48, 16); None: everywhere.
        """
        full = np.ones((self.image.height, self.image.width), np.uint16)
        seen = model_image(full, self.image)[1]
        return None if seen.all() else Constant(seen)


def load_camera(name_or_path: str) -> DepthCamera:
    """A camera by name, or from a TOML file, whose name it has if it does not say another.

    Raises:
        ConfigError: neither a name nor a file; not TOML; an unknown key (the nearest is named); a
            number that cannot be.
    """
    if name_or_path in SHIPPED:
        return SHIPPED[name_or_path]
    path = Path(name_or_path)
    if path.suffix != ".toml" and not path.is_file():
        raise ConfigError(
            f"no camera '{name_or_path}': {nearest_hint(name_or_path, SHIPPED)}; or give a TOML "
            "file"
        )
    camera = read_file(path, DepthCamera.from_toml)
    return camera if camera.name != "d435i" else replace(camera, name=path.stem)


def recorded_camera(record: str | dict[str, object]) -> DepthCamera:
    """The camera of `DepthCamera.record`; what a table does not name is as in d435i."""
    if isinstance(record, str):
        return SHIPPED[record]
    views = {
        table: _whole(table, view)
        for table in _VIEWS
        if isinstance(view := record.get(table), dict)
    }
    base = SHIPPED["d435i"]
    return with_changes(replace(base, sensor=None) if views else base, {**record, **views})


def _whole(table: str, view: dict[str, Any]) -> dict[str, Any]:
    """A table of pixels with its focal lengths and centre."""
    given, angles = dict(view), view.get("fov_deg")
    wanted = ("width", "height") if angles is not None else ("width", "height", "fx", "fy")
    missing = [name for name in wanted if name not in given]
    if missing or (angles is not None and given.keys() & {"fx", "fy"}):
        lacks = f"; it lacks {', '.join(missing)}" if missing else ""
        raise ConfigError(
            f"[{table}] must name width, height, and either fov_deg or fx and fy{lacks}"
        )
    sides = {"x": given["width"], "y": given["height"]}
    if not all(isinstance(side, int) and not isinstance(side, bool) for side in sides.values()):
        raise ConfigError(
            f"[{table}] width = {sides['x']!r}, height = {sides['y']!r}: they must be whole numbers"
        )
    if angles is not None:
        given.pop("fov_deg")
        numbers = (
            isinstance(angles, list)
            and len(angles) == 2
            and all(isinstance(a, int | float) for a in angles)
        )
        if not numbers or not all(0.0 < angle < 180.0 for angle in angles):
            raise ConfigError(
                f"[{table}] fov_deg = {angles!r}: it must be two angles between 0 and 180"
            )
        for (axis, side), angle in zip(sides.items(), angles, strict=True):
            given[f"f{axis}"] = 0.5 * side / math.tan(0.5 * math.radians(angle))
    return {"cx": 0.5 * sides["x"], "cy": 0.5 * sides["y"], **given}


# At the left border of a whole image nothing is matched. Hole filling puts the depth of higher rows
# there, which is farther: level ground beside a robot that stood was told 0.3 m too low.
_UNFILTERED = {
    "hole_filling": {"mode": 0.0},
    "spatial_filter": {"magnitude": 0.0, "alpha": 1.0, "delta": 0.0, "holes_fill": 0.0},
    "temporal_filter": {"alpha": 1.0, "delta": 0.0},
}
SHIPPED = {
    camera.name: camera
    for camera in (
        DepthCamera(name="ideal", image=MODEL_CAMERA, ideal=True),
        DepthCamera(
            name="d435i",
            image=supersampled_model_camera(NATIVE_PIXELS, NATIVE_PIXELS),
            sensor=D435I,
        ),
        DepthCamera(
            name="d435i_whole",
            image=Intrinsics(
                width=D435I.width // DECIMATION, height=D435I.height // DECIMATION,
                fx=D435I.fx / DECIMATION, fy=D435I.fy / DECIMATION,
                cx=D435I.cx / DECIMATION, cy=D435I.cy / DECIMATION,
            ),
            sensor=D435I,
            stereo=_UNFILTERED,
        ),
    )
}  # fmt: skip
"""True depth as the model sees it.

The centre crop of a D435i at 424x240, 80 pixels wide, with its errors. And the whole image, 90 x 59
degrees, decimated and otherwise unfiltered: a robot that walks looks beside its middle line, where
its feet go. A pixel there has the errors of one of the sensor's; the real filter's are means of
those that are valid.
"""
