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


class RosMessage(Protocol):
    """Any message of a `rosbags` type store."""

    __msgtype__: ClassVar[str]


class RosTime(Protocol):
    """`builtin_interfaces/msg/Time`."""

    sec: int
    nanosec: int


class RosHeader(Protocol):
    """`std_msgs/msg/Header`."""

    stamp: RosTime
    frame_id: str


class StampedRosMessage(RosMessage, Protocol):
    """A message with a header."""

    header: RosHeader


class RosVector(Protocol):
    """`geometry_msgs/msg/Vector3` or `Point`."""

    x: float
    y: float
    z: float


class RosQuaternion(Protocol):
    """`geometry_msgs/msg/Quaternion`."""

    x: float
    y: float
    z: float
    w: float


class RosPose(Protocol):
    """`geometry_msgs/msg/Pose`."""

    position: RosVector
    orientation: RosQuaternion


class RosPoseWithCovariance(Protocol):
    """`geometry_msgs/msg/PoseWithCovariance`."""

    pose: RosPose


class RosTwist(Protocol):
    """`geometry_msgs/msg/Twist`."""

    linear: RosVector
    angular: RosVector


class RosTwistWithCovariance(Protocol):
    """`geometry_msgs/msg/TwistWithCovariance`."""

    twist: RosTwist


class RosOdometry(StampedRosMessage, Protocol):
    """`nav_msgs/msg/Odometry`."""

    pose: RosPoseWithCovariance
    twist: RosTwistWithCovariance


class RosImu(StampedRosMessage, Protocol):
    """`sensor_msgs/msg/Imu`."""

    orientation: RosQuaternion
    orientation_covariance: Floats
    angular_velocity: RosVector
    linear_acceleration: RosVector


class RosJointState(StampedRosMessage, Protocol):
    """`sensor_msgs/msg/JointState`."""

    name: Sequence[str]
    position: Floats
    velocity: Floats
    effort: Floats


class RosImage(StampedRosMessage, Protocol):
    """`sensor_msgs/msg/Image`."""

    height: int
    width: int
    encoding: str
    is_bigendian: int
    step: int
    data: NDArray[np.uint8]


class RosCompressedImage(StampedRosMessage, Protocol):
    """`sensor_msgs/msg/CompressedImage`."""

    format: str
    data: NDArray[np.uint8]


AnyRosImage = RosImage | RosCompressedImage


class RosRegionOfInterest(Protocol):
    """`sensor_msgs/msg/RegionOfInterest`."""

    x_offset: int
    y_offset: int
    width: int
    height: int


class RosCameraInfo(StampedRosMessage, Protocol):
    """`sensor_msgs/msg/CameraInfo`; its matrices are k and p in ROS 2, K and P in ROS 1."""

    height: int
    width: int
    binning_x: int
    binning_y: int
    roi: RosRegionOfInterest
