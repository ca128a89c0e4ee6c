"""A pin-hole camera on the robot: where it is and where its pixels look.

Camera frame: x right in the image, y down in the image, z forward along the optical axis.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Array
from saltus.depth import MODEL_CAMERA, Intrinsics
from saltus.effects.camera import ViewChain
from saltus.effects.signals import CameraView
from saltus.errors import SaltusError
from saltus.robots.mount import Mount
from saltus.robots.robot import Robot
from saltus.rotations import rotation_matrix


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotCamera:
    """A camera on a robot, and what of the robot it can see.

    Raises:
        SaltusError: the camera is no pin-hole, or its place is no place or inside of the trunk.
    """

    robot: Robot
    intrinsics: Intrinsics
    mount: Mount
    legs: bool = True
    """True where the robot's legs can be seen."""

    def __post_init__(self) -> None:
        _check_pinhole(self.intrinsics)
        _check_mount(self.mount, self.robot)

    @classmethod
    def on(
        cls, robot: Robot, intrinsics: Intrinsics = MODEL_CAMERA, *, legs: bool = True
    ) -> "RobotCamera":
        """A camera where the robot has its own."""
        return cls(robot=robot, intrinsics=intrinsics, mount=Mount.of(robot), legs=legs)

    def moved(self, view: ViewChain) -> "RobotCamera":
        """The camera as it really is, for this one that is claimed,
        by effects on its place and how wide it looks.
        """
        position, pitch = np.asarray(self.mount.position), np.asarray(self.mount.pitch)
        true = view.apply(CameraView(position=position, pitch=pitch, tangent_scale=np.asarray(1.0)))
        wider, claimed = float(true.tangent_scale), self.intrinsics
        return replace(
            self,
            intrinsics=replace(claimed, fx=claimed.fx / wider, fy=claimed.fy / wider),
            mount=replace(
                self.mount,
                position=true.position,
                pitch=true.pitch if true.pitch.ndim else float(true.pitch),
            ),
        )


def camera_pose(mount: Mount, base_position: Array, base_quaternion: Array) -> tuple[Array, Array]:
    """Pose of the camera in the world.

    Args:
        mount: on the trunk.
        base_position: [m], world frame, numpy or torch, shape (..., 3).
        base_quaternion: (w, x, y, z), base to world, shape (..., 4).

    Returns:
        Optical centre [m], world frame, shape (..., 3), and rotation from camera to world, shape
        (..., 3, 3).
    """
    base_in_world = rotation_matrix(base_quaternion)
    position, rotation = (constant.like(base_in_world) for constant in mount.in_base)
    return base_position + (base_in_world @ position[..., None])[..., 0], base_in_world @ rotation


def ray_directions(intrinsics: Intrinsics) -> NDArray[np.float64]:
    """Direction of each pixel in the camera frame, scaled to depth 1,
    so that a ray's parameter is depth.

    Shape (height, width, 3).
    """
    x = (np.arange(intrinsics.width) + 0.5 - intrinsics.cx) / intrinsics.fx
    y = (np.arange(intrinsics.height) + 0.5 - intrinsics.cy) / intrinsics.fy
    grid_x, grid_y = np.meshgrid(x, y)
    return np.stack([grid_x, grid_y, np.ones_like(grid_x)], axis=-1)


def _check_pinhole(intrinsics: Intrinsics) -> None:
    for name, value in vars(intrinsics).items():
        if not math.isfinite(value) or (name not in ("cx", "cy") and value <= 0):
            allowed = "finite" if name in ("cx", "cy") else "finite and positive"
            raise SaltusError(
                f"camera of {intrinsics.width} x {intrinsics.height} pixels: {name} = {value}; it "
                f"must be {allowed}"
            )


def _check_mount(mount: Mount, robot: Robot) -> None:
    position = np.asarray(mount.position)
    angles = mount.roll, mount.pitch, mount.yaw
    if not (np.isfinite(position).all() and all(np.isfinite(angle).all() for angle in angles)):
        raise SaltusError(
            f"camera mount at {position.tolist()} m, roll, pitch, yaw {angles} rad: every number "
            "must be finite"
        )
    if (np.abs(position - robot.trunk_center) <= 0.5 * robot.trunk_size).all(-1).any():
        raise SaltusError(
            f"camera mount at {position.tolist()} m is inside the robot's trunk, which reaches to "
            f"{(0.5 * robot.trunk_size).tolist()} m from its centre"
        )
