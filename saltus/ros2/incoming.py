"""Messages of ROS from somebody's robot, made ours:
what the heightmap service reads, and nothing to be obeyed.

Bytes come from whoever reaches the ROS router. `RosIntake` counts what it cannot use and goes on;
what it makes of the rest is checked once more by whoever reads it on the bus.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from saltus.arrays import Floats
from saltus.depth import MILLIMETRE
from saltus.errors import ConfigError, MessageError, nearest_hint
from saltus.recordings import ros_messages as ros
from saltus.recordings.log_units import check_depth_unit
from saltus.recordings.ros_images import (
    COMPRESSED,
    is_rectified,
    pixels_in_millimetres,
    pixels_of,
    ros_intrinsics,
)
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import JOINTS, Robot
from saltus.ros2.wall_clock import WallClock
from saltus.rotations import rotation_matrix
from saltus.wire.messages import ControllerMode, DepthFrame, RobotState
from saltus.wire.ros_types import AnyRosImage, RosJointState, RosVector
from saltus.wire.topics import TOPICS

HELD_S = TOPICS["controller/state"].invalid_age_s
"""A reading that is older is not used: nor would a state of that age be."""
# sensor_msgs/msg/Imu: first entry of the covariance of an orientation that it does not have
NO_ATTITUDE = -1.0
TYPES = {
    "depth": "sensor_msgs/msg/Image",
    "camera_info": "sensor_msgs/msg/CameraInfo",
    "joints": "sensor_msgs/msg/JointState",
    "imu": "sensor_msgs/msg/Imu",
    "odometry": "nav_msgs/msg/Odometry",
}
"""Type of each message that is taken from ROS."""
DEPTH = "/camera/depth/image_rect_raw"
"""Topic of the depth images, if nobody names another."""


@dataclass(frozen=True, eq=False)
class NewestMessage:
    """The newest message of a kind that came from ROS, and when."""

    message: Any
    time_ns: int
    """Its stamp in the run's clock."""


@dataclass(eq=False)
class _Images:
    """Images of one camera."""

    topic: str
    taken: int = 0


class RosIntake:
    """Makes depth frames and robot states of what comes from ROS.

    Args:
        robot: What their robot is; its joints are named as in `JOINTS`, with or without "_joint",
            unless `joints` are their names of these twelve, in this order.
        clock: Turns their stamps into times of the run.
        joints: Names of their joints.
        arrival: Take messages to be true when they arrive, for robots whose stamps are no wall
            clock.
        has_joints: False of a robot whose joints nobody tells: its legs are unknown, which heights
            of any grid bear.
        base_height_m: Of the base above the ground when such a robot stands [m]; that of `robot`,
            if None.
        depth: Topic of the depth images. Its name says whether they are compressed, and whether
            they are rectified.
        cameras: The same of further cameras, by name. Their messages are of the kinds `depth/NAME`
            and `camera_info/NAME`.
        depth_unit_m: Metres that one step of their depth images is; as ROS has it (REP 118), if
            None.

    Raises:
        ConfigError: other than twelve names of joints, or one twice; a unit that no camera has.
    """

    def __init__(
        self, robot: Robot, clock: WallClock, joints: tuple[str, ...] = (), *,
        arrival: bool = False,
        has_joints: bool = True, base_height_m: float | None = None, depth: str = DEPTH,
        cameras: Mapping[str, str] | None = None, depth_unit_m: float | None = None,
    ) -> None:  # fmt: skip
        if depth_unit_m is not None:
            check_depth_unit(depth_unit_m)
        if joints and len(set(joints)) != len(JOINTS):
            known = ", ".join(JOINTS)
            raise ConfigError(
                f"{len(set(joints))} names of joints, where a robot has {len(JOINTS)}: {known}"
            )
        self.rejected: Counter[str] = Counter()
        """Messages that were of no use, by "kind/reason"."""
        self._names = joints or JOINTS
        self._needed = ("joints", "imu", "odometry") if has_joints else ("imu", "odometry")
        self._robot = robot
        self._base_height_m = robot.stand_height if base_height_m is None else base_height_m
        self._legs = LegKinematics(robot)
        self._clock = clock
        self._arrival = arrival
        topics = {"": depth, **(cameras or {})}
        self._images = {name: _Images(topic) for name, topic in topics.items()}
        self._depth_unit_m = depth_unit_m
        self._newest: dict[str, NewestMessage] = {}
        self._steps = 0

    def type_of(self, kind: str) -> str:
        """Type of the messages of a kind: images are compressed where their topic says so."""
        name, _, camera = kind.partition("/")
        is_compressed = self._images[camera].topic.endswith("/compressedDepth")
        return COMPRESSED if name == "depth" and is_compressed else TYPES[name]

    def take(self, kind: str, payload: bytes, now_ns: int) -> DepthFrame | None:
        """Takes a message of a kind of `TYPES`,
        of a further camera `KIND/NAME`, at a time of the run.

        Returns an image where it brings one.
        """
        name, _, camera = kind.partition("/")
        try:
            message = ros.decode_ros_message(self.type_of(kind), payload)
            time_ns = (
                now_ns if self._arrival else self._clock.run_ns(ros.time_of(message.header.stamp))
            )
            if not -HELD_S < 1e-9 * (now_ns - time_ns) < 1e3 * HELD_S:
                raise MessageError("clock", f"{1e-9 * (now_ns - time_ns):.1f} s old")
            if name == "depth":
                return self._image(message, time_ns, camera)
            if kind == "joints":
                self._order(message)
            self._newest[kind] = NewestMessage(message, time_ns)
        except MessageError as error:
            self.rejected[f"{kind}/{error.reason}"] += 1
        return None

    def state(self, now_ns: int) -> RobotState | None:
        """The robot as its newest readings have it; None while one is missing or too old."""
        if self.missing(now_ns):
            return None
        imu, odometry = (self._newest[kind].message for kind in ("imu", "odometry"))
        turned = (
            imu.orientation
            if imu.orientation_covariance[0] != NO_ATTITUDE
            else odometry.pose.pose.orientation
        )
        quaternion = np.array([turned.w, turned.x, turned.y, turned.z])
        norm = float(np.linalg.norm(quaternion))
        if not 0.5 < norm < 2.0:  # all zeros: nobody has set it
            self.rejected["imu/attitude"] += 1
            return None
        quaternion /= norm
        rotation = rotation_matrix(quaternion)
        position, velocity, torque, height = self._joints(rotation)
        place = _vector(odometry.pose.pose.position)
        self._steps += 1
        return RobotState(
            time_ns=now_ns,
            step=self._steps - 1,
            quaternion_base_in_world=quaternion,
            angular_velocity_base=_vector(imu.angular_velocity),
            acceleration_base=_vector(imu.linear_acceleration),
            joint_position=position,
            joint_velocity=velocity,
            joint_torque=torque,
            velocity_base_in_world=rotation @ _vector(odometry.twist.twist.linear),
            base_height=height,
            leg_contact=np.ones(4, np.bool_),
            leg_progress=np.full(4, 0.5),
            leg_trusted=np.zeros(4, np.bool_),  # nobody says which feet surely stand
            cycle=0,
            mode=ControllerMode.RUN,
            depth_due=-1,
            position_base_in_odometry=place
            if place.any()
            else np.zeros(0),  # all zeros: nobody has set it
        )

    def _joints(self, rotation: Floats) -> tuple[Floats, Floats, Floats, float]:
        """Angles, speeds, torques, and height of the base where the lowest foot stands,
        or usually [m].
        """
        if "joints" not in self._needed:
            return (
                self._robot.stand_pose,
                np.zeros(len(JOINTS)),
                np.zeros(len(JOINTS)),
                self._base_height_m,
            )
        joints = self._newest["joints"].message
        order = self._order(joints)
        position, velocity, torque = (
            self._ordered(values, order)
            for values in (joints.position, joints.velocity, joints.effort)
        )
        feet = self._legs.position(position) @ rotation.T
        return position, velocity, torque, float(self._robot.foot_radius - feet[:, 2].min())

    def missing(self, now_ns: int) -> list[str]:
        """Parts of a state that have not come or are too old."""
        oldest_ns = now_ns - round(1e9 * HELD_S)
        return [
            kind
            for kind in self._needed
            if kind not in self._newest or self._newest[kind].time_ns < oldest_ns
        ]

    def _image(self, image: AnyRosImage, time_ns: int, camera: str) -> DepthFrame:
        of_camera = "camera_info" + (f"/{camera}" if camera else "")
        if of_camera not in self._newest:
            raise MessageError("no_camera_info")
        pixels, unit_m = pixels_of(image), MILLIMETRE
        if pixels.dtype.kind == "u" and self._depth_unit_m is not None:
            depth, unit_m = pixels, self._depth_unit_m  # steps as they came
        else:
            depth = pixels_in_millimetres(pixels, self._depth_unit_m)
        info, (height, width) = self._newest[of_camera].message, depth.shape
        images = self._images[camera]
        lens = ros_intrinsics(info, width, height, rectified=is_rectified(images.topic))
        images.taken += 1
        return DepthFrame(
            time_ns=time_ns,
            frame_id=images.taken - 1,
            depth=depth,
            depth_unit_m=unit_m,
            **vars(lens),
        )

    def _order(self, joints: RosJointState) -> list[int]:
        """Where each of our joints is among theirs."""
        theirs = {name.removesuffix("_joint"): place for place, name in enumerate(joints.name)}
        for name in (name.removesuffix("_joint") for name in self._names):
            if name not in theirs:
                raise MessageError(
                    "joint_names", f"no joint '{name}': {nearest_hint(name, theirs)}"
                )
        order = [theirs[name.removesuffix("_joint")] for name in self._names]
        if len(joints.position) != len(joints.name):
            raise MessageError(
                "joints", f"{len(joints.position)} positions of {len(joints.name)} joints"
            )
        return order

    def _ordered(self, values: Floats, order: list[int]) -> Floats:
        """Counted our way; zeros where they do not say it."""
        if len(values) <= max(order):
            return np.zeros(len(JOINTS))
        return np.asarray(np.asarray(values, dtype=np.float64)[order] * self._robot.joint_sign)


def _vector(vector: RosVector) -> Floats:
    return np.array([vector.x, vector.y, vector.z])
