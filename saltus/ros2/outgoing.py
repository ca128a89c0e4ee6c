"""Messages of a run for ROS, of its own types, made of ours.

Never of what only a simulator knows.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.recordings import ros_messages as ros
from saltus.recordings.ros_messages import BASE, BASE_YAW, ODOM
from saltus.recordings.viewer import RobotFrames
from saltus.robots.robot import JOINTS, Robot
from saltus.ros2.wall_clock import WallClock
from saltus.rotations import quaternion_inverse, quaternion_product
from saltus.wire.cdr import make_ros_header
from saltus.wire.depth_codec import depth_on_the_wire
from saltus.wire.messages import DepthFrame, Heightmap, RobotState
from saltus.wire.ros_types import RosMessage

TRANSFORMS = "/tf"
HEIGHTS = {
    "elevation_map_raw": (
        "grid_map_msgs/msg/GridMap",
        "predicted heights: layers elevation, variance, half_width; of a scan age",
    ),
    "heights": (
        "sensor_msgs/msg/PointCloud2",
        "the same as points, each with half_width_90, and of a scan age",
    ),
}
"""Type and meaning of each topic below the namespace."""
ROBOT = {
    "depth/image_rect_raw": ("sensor_msgs/msg/Image", "depth, 16UC1"),
    "depth/camera_info": ("sensor_msgs/msg/CameraInfo", "its intrinsics"),
    "joint_states": (
        "sensor_msgs/msg/JointState",
        "positions, velocities, torques of the twelve joints",
    ),
    "odom": (
        "nav_msgs/msg/Odometry",
        "attitude of the IMU, estimated velocity, and the way that it adds up to",
    ),
}
"""Topics that come only from a run with a robot of its own, not where ROS brings the robot."""
GAP_NS = 1_000_000_000  # a robot that was silent for so long has not gone on at its last velocity


@dataclass(frozen=True, eq=False)
class OutgoingRosMessage:
    """One message that is to be sent to ROS: its topic, type and bytes."""

    topic: str
    """Below the namespace, or "/tf"."""
    message: RosMessage


class RosExporter:
    """Makes messages for ROS of those of a run.

    Args:
        robot: Of the run.
        clock: Times that ROS is told.
        base: Frame of the trunk.
        whole: Whether ROS is told of the robot too, or of its heights alone.
    """

    def __init__(
        self, robot: Robot, clock: WallClock, *, base: str = BASE, whole: bool = True
    ) -> None:
        self.topics = {
            name: kind for name, (kind, _) in (HEIGHTS | (ROBOT if whole else {})).items()
        }
        """Type of each topic below the namespace."""
        self._frames = RobotFrames(robot, base)
        self._clock = clock
        self._base = base
        self._whole = whole
        self._way = EstimatedWay()

    def of_heightmap(self, heightmap: Heightmap) -> Iterator[OutgoingRosMessage]:
        """Heights in the frame `base_yaw`."""
        dated = replace(heightmap, time_ns=self._clock.wall_ns(heightmap.time_ns))
        yield OutgoingRosMessage("elevation_map_raw", ros.grid_map(dated))
        yield OutgoingRosMessage("heights", ros.height_points(dated))

    def of_frame(self, frame: DepthFrame) -> Iterator[OutgoingRosMessage]:
        """A depth image with its intrinsics."""
        if self._whole:
            depth = millimetres(frame)
            time_ns = self._clock.wall_ns(frame.time_ns)
            wire = depth_on_the_wire(
                replace(frame, time_ns=time_ns, depth=depth, depth_unit_m=1e-3)
            )
            yield OutgoingRosMessage("depth/image_rect_raw", wire.image)
            yield OutgoingRosMessage("depth/camera_info", wire.camera_info)

    def of_state(self, state: RobotState) -> Iterator[OutgoingRosMessage]:
        """Joints, odometry and frames.

        Of a robot that ROS brings only the frames of camera and heights.
        """
        time_ns = self._clock.wall_ns(state.time_ns)
        turned = np.asarray(state.quaternion_base_in_world, dtype=np.float64)
        yaw = quaternion_product(quaternion_inverse(turned), np.asarray(ros.yaw_of(turned)))
        transforms = [
            ros.place(
                make_ros_header(time_ns, self._base),
                BASE_YAW,
                ros.vector(np.zeros(3)),
                ros.quaternion(yaw),
            ),
            self._frames.camera(time_ns),
        ]
        if self._whole:
            position = self._way.go(state)
            where = ros.place(
                make_ros_header(time_ns, ODOM),
                self._base,
                ros.vector(position),
                ros.quaternion(turned),
            )
            transforms = [where, *transforms, *self._frames.links(time_ns, state.joint_position)]
            yield OutgoingRosMessage("joint_states", ros.joint_state(time_ns, list(JOINTS), state))
            yield OutgoingRosMessage("odom", ros.odometry(time_ns, self._base, position, state))
        yield OutgoingRosMessage(
            TRANSFORMS, ros.make("tf2_msgs/msg/TFMessage", transforms=transforms)
        )


def millimetres(frame: DepthFrame) -> NDArray[np.uint16]:
    """A depth image as ROS has it (REP 118): in millimetres,
    0 where there is none, also for nothing within range.
    """
    depth = np.where(frame.depth == np.iinfo(np.uint16).max, 0, frame.depth)
    scaled = np.rint(depth * (frame.depth_unit_m / 1e-3))
    return np.where(scaled > np.iinfo(np.uint16).max, 0, scaled).astype(np.uint16)


class EstimatedWay:
    """Where a robot is by adding up its estimated velocities: it drifts, as the frame odom may."""

    def __init__(self) -> None:
        self._position: Floats | None = None
        self._time_ns = 0

    def go(self, state: RobotState) -> Floats:
        """Position of the base in odom at a state [m], shape (3,); at first above the origin."""
        passed_ns = state.time_ns - self._time_ns
        if self._position is None:
            self._position = np.array([0.0, 0.0, state.base_height])
        elif 0 < passed_ns < GAP_NS:
            self._position = self._position + 1e-9 * passed_ns * np.asarray(
                state.velocity_base_in_world
            )
        self._time_ns = state.time_ns
        return self._position
