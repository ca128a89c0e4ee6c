"""The signals that effects change, a frozen dataclass a site.

That of "command" is `joint_command.JointCommand`.
"""

import math
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Array, Floats, Images, Joints, Scalars, Vectors, namespace


@dataclass(frozen=True, kw_only=True, eq=False)
class EncoderReading:
    """Readings of the drives' encoders. Site "joint_state"."""

    position: Joints
    """[rad], shape (..., 12)."""
    velocity: Joints
    """[rad/s], shape (..., 12)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DriveTorque(EncoderReading):
    """Torque inside a drive, with the true motion of its joint. Site "torque"."""

    torque: Joints
    """[Nm], shape (..., 12)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Resistance:
    """Forces that resist the motion of a joint beside its links.

    The physics integrates it implicitly. Site "joint".
    """

    velocity: Joints
    """Velocity of the joint [rad/s], shape (..., 12)."""
    friction: Joints
    """Dry friction: largest torque against the motion [Nm], shape (..., 12)."""
    damping: Joints
    """Torque against the motion by velocity [Nm s/rad], shape (..., 12)."""
    armature: Joints
    """Inertia on top of that of the model [kg m^2], shape (..., 12)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthImage:
    """The newest depth image that there is at some point between exposure and arrival.

    Site "depth".
    """

    depth: Images
    """Along the optical axis, shape (..., height, width). Floats are metres: so the effects of a
    camera get it; nothing within range is infinite. Whole numbers are millimetres, as it is kept
    and sent (`saltus.depth.depth_in_millimetres`); there that is 65535. 0 is invalid."""
    time_s: Scalars
    """Capture time in the run's clock [s], float64, shape (...); -inf where there is no image
    yet."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraView:
    """Where a camera sits on the trunk and how wide it looks. Site "view"."""

    position: Vectors
    """Optical centre, trunk frame [m], shape (..., 3)."""
    pitch: Scalars
    """Nose down positive [rad], shape (...)."""
    tangent_scale: Floats
    """True over claimed tangent of a pixel's angle to the optical axis, shape (...)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightQuery:
    """Where a heightmap is read, and what is added to what is read. Site "heightmap"."""

    x: Floats
    """Distance ahead of the base along its yaw [m], shape (..., 30)."""
    offset: Floats
    """Added to every height [m], shape (..., 1)."""


def nothing_yet(like: DepthImage) -> DepthImage:
    """The image before the first: invalid everywhere, of infinite age.

    Shapes and types as `like`.
    """
    xp = namespace(like.depth)
    never = namespace(like.time_s).full_like(like.time_s, -math.inf)
    return DepthImage(depth=xp.zeros_like(like.depth), time_s=never)


def choose_images(condition: Array, image: DepthImage, otherwise: DepthImage) -> DepthImage:
    """For each robot, `image` where `condition`, shape (...), else `otherwise`."""
    if isinstance(condition, np.bool_):  # of one robot nothing need be copied
        return image if condition else otherwise
    xp = namespace(image.depth)
    time_s = xp.where(condition, image.time_s, otherwise.time_s)
    return DepthImage(
        depth=xp.where(condition[..., None, None], image.depth, otherwise.depth), time_s=time_s
    )
