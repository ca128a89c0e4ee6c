"""What ROS tells of somebody's robot, as messages of ours: what the heightmap service reads, and nothing to be obeyed.

Bytes come from whoever reaches the ROS router. `Intake` counts what it cannot use and goes on; what it makes of the
rest is checked once more by whoever reads it on the bus.
"""

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from saltus.errors import ConfigError, MessageError, nearest_hint
from saltus.recordings import ros_messages as ros
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import JOINTS, Robot
from saltus.ros2.wall_clock import WallClock
from saltus.rotations import rotation_matrix
from saltus.wire.messages import ControllerMode, DepthFrame, Floats, RobotState
from saltus.wire.topics import TOPICS

MILLIMETRE = 0.001
NOTHING = np.iinfo(np.uint16).max  # in a depth image: nothing within range
HELD_S = TOPICS["controller/state"].invalid_age_s
"""A reading that is older is not used: nor would a state of that age be."""
NO_ATTITUDE = -1.0  # sensor_msgs/msg/Imu: first entry of the covariance of an orientation that it does not have
TYPES = {
    "depth": "sensor_msgs/msg/Image",
    "camera_info": "sensor_msgs/msg/CameraInfo",
    "joints": "sensor_msgs/msg/JointState",
    "imu": "sensor_msgs/msg/Imu",
    "odometry": "nav_msgs/msg/Odometry",
}
"""What is taken from ROS: the type of each."""


@dataclass(frozen=True, eq=False)
class Reading:
    """The newest message of a kind."""

    message: Any
    time_ns: int
    """Its stamp in the run's clock."""


class Intake:
    """Makes depth frames and robot states of what comes from ROS.

    Args:
        robot: What their robot is; its joints are named as in `JOINTS`, with or without "_joint", unless `joints` are
            their names of these twelve, in this order.
        clock: Turns their stamps into times of the run.
        joints: Names of their joints.
        arrival: Take messages to be true when they arrive, for robots whose stamps are no wall clock.

    Raises:
        ConfigError: other than twelve names of joints, or one twice.
    """

    def __init__(self, robot: Robot, clock: WallClock, joints: tuple[str, ...] = (), *, arrival: bool = False) -> None:
        if joints and len(set(joints)) != len(JOINTS):
            known = ", ".join(JOINTS)
            raise ConfigError(f"{len(set(joints))} names of joints, where a robot has {len(JOINTS)}: {known}")
        self.rejected: Counter[str] = Counter()
        """Messages that were of no use, by "kind/reason"."""
        self._names = joints or JOINTS
        self._robot = robot
        self._legs = LegKinematics(robot)
        self._clock = clock
        self._arrival = arrival
        self._newest: dict[str, Reading] = {}
        self._frames = self._steps = 0

    def take(self, kind: str, payload: bytes, now_ns: int) -> DepthFrame | None:
        """Takes a message of a kind of `TYPES` at a time of the run; returns an image where it brings one."""
        try:
            message = ros.decode(TYPES[kind], payload)
            time_ns = now_ns if self._arrival else self._clock.run_ns(ros.time_of(message.header.stamp))
            if not -HELD_S < 1e-9 * (now_ns - time_ns) < 1e3 * HELD_S:
                raise MessageError("clock", f"{1e-9 * (now_ns - time_ns):.1f} s old")
            if kind == "depth":
                return self._image(message, time_ns)
            if kind == "joints":
                self._order(message)
            self._newest[kind] = Reading(message, time_ns)
        except MessageError as error:
            self.rejected[f"{kind}/{error.reason}"] += 1
        return None

    def state(self, now_ns: int) -> RobotState | None:
        """The robot as its newest readings have it; None while one is missing or too old."""
        if self.missing(now_ns):
            return None
        joints, imu, odometry = (self._newest[kind].message for kind in ("joints", "imu", "odometry"))
        turned = imu.orientation if imu.orientation_covariance[0] != NO_ATTITUDE else odometry.pose.pose.orientation
        quaternion = np.array([turned.w, turned.x, turned.y, turned.z])
        norm = float(np.linalg.norm(quaternion))
        if not 0.5 < norm < 2.0:  # all zeros: nobody has set it
            self.rejected["imu/attitude"] += 1
            return None
        quaternion /= norm
        rotation = rotation_matrix(quaternion)
        order = self._order(joints)
        position = self._ordered(joints.position, order)
        feet = self._legs.position(position) @ rotation.T
        self._steps += 1
        return RobotState(
            time_ns=now_ns,
            step=self._steps - 1,
            quaternion_base_in_world=quaternion,
            angular_velocity_base=_vector(imu.angular_velocity),
            acceleration_base=_vector(imu.linear_acceleration),
            joint_position=position,
            joint_velocity=self._ordered(joints.velocity, order),
            joint_torque=self._ordered(joints.effort, order),
            velocity_base_in_world=rotation @ _vector(odometry.twist.twist.linear),
            base_height=float(self._robot.foot_radius - feet[:, 2].min()),  # its lowest foot stands
            leg_contact=np.ones(4, np.bool_),
            leg_progress=np.full(4, 0.5),
            leg_trusted=np.zeros(4, np.bool_),  # nobody says which feet surely stand
            cycle=0,
            mode=ControllerMode.RUN,
            depth_due=-1,
        )

    def missing(self, now_ns: int) -> list[str]:
        """Of what a state needs: what has not come or is too old."""
        oldest_ns = now_ns - round(1e9 * HELD_S)
        needed = ("joints", "imu", "odometry")
        return [kind for kind in needed if kind not in self._newest or self._newest[kind].time_ns < oldest_ns]

    def _image(self, image: Any, time_ns: int) -> DepthFrame:
        if "camera_info" not in self._newest:
            raise MessageError("no_camera_info")
        info = self._newest["camera_info"].message
        if (info.width, info.height) != (image.width, image.height):
            raise MessageError("camera_info", f"for {info.width}x{info.height}")
        depth = depth_of(image)
        self._frames += 1
        return DepthFrame(
            time_ns=time_ns, frame_id=self._frames - 1, depth=depth, depth_unit_m=MILLIMETRE,
            fx=float(info.k[0]), fy=float(info.k[4]), cx=float(info.k[2]) + 0.5, cy=float(info.k[5]) + 0.5,
        )  # fmt: skip

    def _order(self, joints: Any) -> list[int]:
        """Where each of our joints is among theirs."""
        theirs = {name.removesuffix("_joint"): place for place, name in enumerate(joints.name)}
        for name in (name.removesuffix("_joint") for name in self._names):
            if name not in theirs:
                raise MessageError("joint_names", f"no joint '{name}': {nearest_hint(name, theirs)}")
        order = [theirs[name.removesuffix("_joint")] for name in self._names]
        if len(joints.position) != len(joints.name):
            raise MessageError("joints", f"{len(joints.position)} positions of {len(joints.name)} joints")
        return order

    def _ordered(self, values: Any, order: list[int]) -> Floats:
        """Counted our way; zeros where they do not say it."""
        if len(values) <= max(order):
            return np.zeros(len(JOINTS))
        return np.asarray(np.asarray(values, dtype=np.float64)[order] * self._robot.joint_sign)


def depth_of(image: Any) -> Any:
    """Millimetres of a `sensor_msgs/msg/Image`, uint16: 0 is invalid, 65535 is nothing within range (REP 118).

    Raises:
        MessageError: it is no depth image, or has another size than it says.
    """
    kinds: dict[str, np.dtype[Any]] = {"16UC1": np.dtype("<u2"), "mono16": np.dtype("<u2"), "32FC1": np.dtype("<f4")}
    kind = kinds.get(image.encoding)
    if kind is None or image.is_bigendian:
        raise MessageError("encoding", f"'{image.encoding}', not one of {', '.join(kinds)}")
    width = kind.itemsize * image.width
    if not image.width or not image.height or image.step < width or len(image.data) != image.step * image.height:
        raise MessageError("size", f"{len(image.data)} bytes for {image.width}x{image.height}")
    rows = np.asarray(image.data, np.uint8).reshape(image.height, image.step)[:, :width]
    pixels = np.ascontiguousarray(rows).view(kind)
    if kind.kind == "u":
        return pixels.astype(np.uint16)
    metres = np.where(np.isnan(pixels) | (pixels < 0.0), 0.0, pixels)
    return np.where(np.isinf(metres), NOTHING, np.minimum(np.rint(metres / MILLIMETRE), NOTHING)).astype(np.uint16)


def _vector(vector: Any) -> Floats:
    return np.array([vector.x, vector.y, vector.z])
