"""A pin-hole camera on the robot: where it is and where its pixels look.

Camera frame: x right in the image, y down in the image, z forward along the optical axis.
"""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Array, Constant
from saltus.depth import Intrinsics
from saltus.effects.camera import ViewChain
from saltus.effects.signals import CameraView
from saltus.errors import SaltusError
from saltus.go1 import CAMERA_PITCH, CAMERA_POSITION, TRUNK_SIZE
from saltus.rotations import rotation_matrix
from saltus.wire.messages import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Mount:
    """Where a camera sits on the trunk; by default where the Go1's does.

    The cameras of a batch of robots may each have a place of their own: then the poses that a mount is used with, and
    its numbers, share their leading dimension (n,).
    """

    position: Floats = field(default_factory=CAMERA_POSITION.copy)
    """Optical centre in the base frame [m], shape (3,) or (n, 3)."""
    pitch: float | Floats = CAMERA_PITCH
    """Nose down positive [rad], one number or shape (n,)."""

    @property
    def rotation(self) -> Floats:
        """Camera frame to base frame, shape (3, 3) or (n, 3, 3)."""
        c, s = np.cos(self.pitch), np.sin(self.pitch)
        zero, one = np.zeros_like(c), np.ones_like(c)
        right, down, forward = (zero, -one, zero), (-s, zero, -c), (c, zero, -s)
        return np.stack([np.stack(axis, -1) for axis in (right, down, forward)], -1)

    @cached_property
    def in_base(self) -> tuple[Constant, Constant]:
        """Position and rotation for arrays of any library."""
        return Constant(self.position), Constant(self.rotation)


def moved_camera(view: ViewChain, camera: Intrinsics, mount: Mount | None = None) -> tuple[Intrinsics, Mount]:
    """The camera as it really is, for one that is claimed.

    Args:
        view: effects on where it sits and how wide it looks.
        camera: claimed.
        mount: claimed; the Go1's where it is not given.
    """
    mount = mount or Mount()
    claimed = CameraView(
        position=np.asarray(mount.position), pitch=np.asarray(mount.pitch), tangent_scale=np.asarray(1.0)
    )
    true = view.moved(claimed)
    wider = float(true.tangent_scale)
    return (
        replace(camera, fx=camera.fx / wider, fy=camera.fy / wider),
        Mount(position=true.position, pitch=float(true.pitch)),
    )


def camera_pose(mount: Mount, base_position: Array, base_quaternion: Array) -> tuple[Array, Array]:
    """Pose of the camera in the world.

    Args:
        mount: on the trunk.
        base_position: [m], world frame, numpy or torch, shape (..., 3).
        base_quaternion: (w, x, y, z), base to world, shape (..., 4).

    Returns:
        Optical centre [m], world frame, shape (..., 3), and rotation from camera to world, shape (..., 3, 3).
    """
    base_in_world = rotation_matrix(base_quaternion)
    position, rotation = (constant.like(base_in_world) for constant in mount.in_base)
    return base_position + (base_in_world @ position[..., None])[..., 0], base_in_world @ rotation


def ray_directions(intrinsics: Intrinsics) -> NDArray[np.float64]:
    """Direction of each pixel in the camera frame, scaled to depth 1, so that a ray's parameter is depth.

    Shape (height, width, 3).
    """
    x = (np.arange(intrinsics.width) + 0.5 - intrinsics.cx) / intrinsics.fx
    y = (np.arange(intrinsics.height) + 0.5 - intrinsics.cy) / intrinsics.fy
    grid_x, grid_y = np.meshgrid(x, y)
    return np.stack([grid_x, grid_y, np.ones_like(grid_x)], axis=-1)


def check_camera(intrinsics: Intrinsics) -> None:
    """Refuses a camera that is no pin-hole.

    Raises:
        SaltusError: a size or focal length that is not positive, or a number that is not finite.
    """
    for name, value in vars(intrinsics).items():
        if not math.isfinite(value) or (name not in ("cx", "cy") and value <= 0):
            allowed = "finite" if name in ("cx", "cy") else "finite and positive"
            raise SaltusError(
                f"camera of {intrinsics.width} x {intrinsics.height} pixels: {name} = {value}; it must be {allowed}"
            )


def check_mount(mount: Mount) -> None:
    """Refuses a camera that would see the robot from inside.

    Raises:
        SaltusError: the optical centre lies in the trunk, or a number is not finite.
    """
    position = np.asarray(mount.position)
    if not (np.isfinite(position).all() and np.isfinite(mount.pitch).all()):
        raise SaltusError(
            f"camera mount at {position.tolist()} m, pitch {mount.pitch} rad: every number must be finite"
        )
    if (np.abs(position) <= 0.5 * TRUNK_SIZE).all(-1).any():
        raise SaltusError(
            f"camera mount at {position.tolist()} m is inside the robot's trunk, which reaches to "
            f"{(0.5 * TRUNK_SIZE).tolist()} m from its centre; the Go1's camera is at {CAMERA_POSITION.tolist()} m"
        )
