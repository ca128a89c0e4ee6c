"""Fields of the ROS messages that are read and made, ROS 1 or 2:
`rosbags` makes their classes at run time.

Messages of strangers are checked where they are read: these types say what a field is called, not
that its values are sound.
"""

from collections.abc import Sequence
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats


class Message(Protocol):
    """Any message of a `rosbags` type store."""

    __msgtype__: ClassVar[str]


class Stamp(Protocol):
    """`builtin_interfaces/msg/Time`."""

    sec: int
    nanosec: int


class Header(Protocol):
    """`std_msgs/msg/Header`."""

    stamp: Stamp
    frame_id: str


class Stamped(Message, Protocol):
    """A message with a header."""

    header: Header


class Vector(Protocol):
    """`geometry_msgs/msg/Vector3` or `Point`."""

    x: float
    y: float
    z: float


class Quaternion(Protocol):
    """`geometry_msgs/msg/Quaternion`."""

    x: float
    y: float
    z: float
    w: float


class Pose(Protocol):
    """`geometry_msgs/msg/Pose`."""

    position: Vector
    orientation: Quaternion


class UncertainPose(Protocol):
    """`geometry_msgs/msg/PoseWithCovariance`."""

    pose: Pose


class Twist(Protocol):
    """`geometry_msgs/msg/Twist`."""

    linear: Vector
    angular: Vector


class UncertainTwist(Protocol):
    """`geometry_msgs/msg/TwistWithCovariance`."""

    twist: Twist


class Odometry(Stamped, Protocol):
    """`nav_msgs/msg/Odometry`."""

    pose: UncertainPose
    twist: UncertainTwist


class Imu(Stamped, Protocol):
    """`sensor_msgs/msg/Imu`."""

    orientation: Quaternion
    orientation_covariance: Floats
    angular_velocity: Vector
    linear_acceleration: Vector


class JointState(Stamped, Protocol):
    """`sensor_msgs/msg/JointState`."""

    name: Sequence[str]
    position: Floats
    velocity: Floats
    effort: Floats


class RawImage(Stamped, Protocol):
    """`sensor_msgs/msg/Image`."""

    height: int
    width: int
    encoding: str
    is_bigendian: int
    step: int
    data: NDArray[np.uint8]


class CompressedImage(Stamped, Protocol):
    """`sensor_msgs/msg/CompressedImage`."""

    format: str
    data: NDArray[np.uint8]


Image = RawImage | CompressedImage


class Region(Protocol):
    """`sensor_msgs/msg/RegionOfInterest`."""

    x_offset: int
    y_offset: int
    width: int
    height: int


class CameraInfo(Stamped, Protocol):
    """`sensor_msgs/msg/CameraInfo`; its matrices are k and p in ROS 2, K and P in ROS 1."""

    height: int
    width: int
    binning_x: int
    binning_y: int
    roi: Region
