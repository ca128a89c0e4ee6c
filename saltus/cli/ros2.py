"""`saltus ros2`: heights, depth and state of a run for ROS 2,
and heights for robots that speak ROS 2.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from saltus.errors import SaltusError
from saltus.extras import check_package
from saltus.flags import EndpointOption, Flag, flag_help

if TYPE_CHECKING:
    from saltus.ros2.dds import DdsNode
    from saltus.wire.ros2_node import Ros2Node

NO_JOINTS = "none"
NAMESPACE = r"/?[A-Za-z]\w*(/[A-Za-z]\w*)*"
DOMAIN_MAX = 232  # of DDS


@dataclass(frozen=True, kw_only=True)
class Ros2(EndpointOption):
    """Joins a ROS 2 graph over rmw_zenoh or DDS: sends heights, depth,
    joints, odometry, frames of a run, until Ctrl-C.

    With --take a robot that speaks ROS 2 is given heights: its depth images, joints, IMU and
    odometry go to the heightmap service. Plans are never taken. The ROS side has no secret: see
    docs/ros2.md.

    For example:
      saltus ros2 --run-dir runs/one
      saltus ros2 --run-dir runs/mine --take --depth /camera/depth/image_rect_raw
      saltus ros2 --run-dir runs/one --dds
      saltus ros2 --run-dir runs/one --cmd-vel /cmd_vel
    """

    run_dir: Path
    """Folder of the run: of `saltus up`, or of `saltus router`."""
    ros_router: str = "tcp/127.0.0.1:7447"
    """The router of the ROS graph, which rmw_zenohd is."""
    dds: Flag = False
    """Over plain DDS in place of Zenoh, for Cyclone DDS and Fast DDS; CYCLONEDDS_URI says how it
    uses the network."""
    domain: int = 0
    """ROS_DOMAIN_ID."""
    namespace: str = "saltus"
    """Namespace of the topics that are sent; also the name of the node."""
    prefix: Annotated[str | None, flag_help("STR", "the one of run.toml")] = None
    """Prefix of the robot's keys, where several share the router of the folder."""
    base_frame: str = "base"
    """The frame of the trunk, in which those of heights and camera hang."""
    take: Flag = False
    """Take in a robot's depth images, joints, IMU and odometry."""
    depth: str = "/camera/depth/image_rect_raw"
    """Taken with --take: sensor_msgs/Image, 16UC1 in millimetres or 32FC1 in metres.

    Or a topic .../compressedDepth.
    """
    depth_unit_m: Annotated[
        float | None, flag_help("FLOAT", "that of the run's camera, else as above")
    ] = None
    """Metres that one step of these images is, where it is another: 0.0001 of a D405, 0.00025 of an
    L515."""
    camera_info: str = "/camera/depth/camera_info"
    """Taken with --take: sensor_msgs/CameraInfo of these images."""
    other_depth: Annotated[tuple[str, ...], flag_help("NAME=TOPIC", "none: one camera")] = ()
    """Taken with --take: depth images of further cameras, NAME as in the camera's TOML file. Their
    CameraInfo is taken beside them: of /rear/depth/image_rect_raw from /rear/depth/camera_info."""
    joints: str = "/joint_states"
    """Taken with --take: sensor_msgs/JointState.

    `none` for heights of any grid, of a robot with other legs.
    """
    base_height_m: Annotated[
        float | None, flag_help("FLOAT", "the stand height of the run's robot")
    ] = None
    """With `--joints none`: height of the base above the ground when the robot stands [m]."""
    imu: str = "/imu/data"
    """Taken with --take: sensor_msgs/Imu in the frame of the trunk."""
    odometry: str = "/odom"
    """Taken with --take: nav_msgs/Odometry, whose velocity is in the frame of the trunk."""
    joint_names: Annotated[
        tuple[str, ...], flag_help("NAME", "FR_hip FR_thigh FR_calf FL_hip ... RL_calf")
    ] = ()
    """Their names of the twelve joints, in the order FR, FL, RR, RL; "_joint" at the end may be
    left out."""
    arrival_times: Flag = False
    """Take messages to be true when they arrive, for robots whose stamps are not this computer's
    time."""

    cmd_vel: Annotated[str | None, flag_help("TOPIC", "none: nothing commands the robot")] = None
    """Taken where it is named, e.g. /cmd_vel: geometry_msgs/Twist, which a robot that walks follows
    for 0.5 s. Whoever reaches the ROS side then moves the robot."""

    def run(self) -> int:
        """Runs until a router is gone or Ctrl-C."""
        from saltus.clock import RunClock
        from saltus.recordings.ros_images import info_of
        from saltus.ros2.bridge import RosReceiver, RosSender, run_bridge
        from saltus.ros2.commands import CommandReceiver
        from saltus.ros2.incoming import RosIntake
        from saltus.ros2.outgoing import RosExporter
        from saltus.ros2.wall_clock import WallClock
        from saltus.runtime.run_folder import endpoint_of, read_run
        from saltus.wire.zenoh_bus import ZenohBus

        if not re.fullmatch(NAMESPACE, self.namespace):
            raise SaltusError(
                f"namespace = {self.namespace}: names of ROS begin with a letter, and hold a-z, "
                "0-9, _ and /"
            )
        if not 0 <= self.domain <= DOMAIN_MAX:
            raise SaltusError(f"domain = {self.domain}: it must be from 0 to {DOMAIN_MAX}")
        if self.base_height_m is not None and not (
            self.take and self.joints == NO_JOINTS and self.base_height_m > 0.0
        ):
            raise SaltusError(
                f"base_height_m = {self.base_height_m}: it must be above 0, and needs --take "
                "--joints none; else it is computed from the legs"
            )
        found = read_run(self.run_dir)
        config, robot = found.config, found.setup.robot
        if self.take and config.epoch_ns:
            raise SaltusError(
                f"{self.run_dir} has a robot of its own: --take needs a folder of saltus router"
            )
        if self.cmd_vel is not None and config.pace != "realtime":
            raise SaltusError("--cmd-vel needs a run in real time: in lockstep no time passes")
        wall, others = WallClock(config), self._others()
        unit_m = found.setup.camera.depth_unit_m if self.depth_unit_m is None else self.depth_unit_m
        intake = RosIntake(
            robot,
            wall,
            self.joint_names,
            arrival=self.arrival_times,
            has_joints=self.joints != NO_JOINTS,
            base_height_m=self.base_height_m,
            depth=self.depth,
            cameras=others,
            depth_unit_m=unit_m,
        )
        exporter = RosExporter(robot, wall, base=self.base_frame, whole=not self.take)
        with (
            ZenohBus(
                self.endpoint or endpoint_of(self.run_dir), self.prefix or config.prefix
            ) as bus,
            self._node() as node,
        ):
            sender, receiver = RosSender(bus, node, exporter, self.namespace), None
            commands = None
            if self.cmd_vel is not None:
                commands = CommandReceiver(bus, node, self.cmd_vel, RunClock.of(config))
            can = ", and can ".join(
                [
                    "reads what is sent here",
                    *(["feed the heights"] if self.take else []),
                    *(["move the robot"] if commands is not None else []),
                ]
            )
            place = (
                f"domain {self.domain} of DDS" if self.dds else f"the router at {self.ros_router}"
            )
            print(f"the ROS side is open: who reaches {place} {can}", flush=True)
            if self.take:
                topics = {
                    "depth": self.depth, "camera_info": self.camera_info, "joints": self.joints,
                    "imu": self.imu,
                    "odometry": self.odometry,
                    **{f"depth/{name}": topic for name, topic in others.items()},
                    **{f"camera_info/{name}": info_of(topic) for name, topic in others.items()},
                }  # fmt: skip
                if self.joints == NO_JOINTS:
                    del topics["joints"]
                receiver = RosReceiver(bus, node, intake, topics, RunClock.of(config), _tell)
            run_bridge(bus, node, sender, receiver, commands)
            print(
                "the run has ended"
                if node.connected()
                else f"the router at {self.ros_router} is gone"
            )
            return 0 if node.connected() else 1

    def _others(self) -> dict[str, str]:
        """Topics of further cameras by name, or `SaltusError`."""
        pairs = [each.partition("=") for each in self.other_depth]
        for name, _, topic in pairs:
            if not re.fullmatch(r"\w+", name) or not topic.startswith("/"):
                raise SaltusError(
                    f"--other-depth {name}={topic}: say NAME=TOPIC, as "
                    "rear=/rear/depth/image_rect_raw"
                )
        names = [name for name, _, _ in pairs]
        if len(set(names)) < len(names):
            raise SaltusError(
                f"--other-depth {', '.join(names)}: each camera must have a name of its own"
            )
        if pairs and not self.take:
            raise SaltusError("--other-depth needs --take")
        return {name: topic for name, _, topic in pairs}

    def _node(self) -> "Ros2Node | DdsNode":
        if self.dds:
            check_package("cyclonedds", "dds", "--dds needs")
            from saltus.ros2.dds import DdsNode

            return DdsNode(self.domain)
        from saltus.wire.ros2_node import Ros2Node

        return Ros2Node(self.ros_router, self.namespace.strip("/").replace("/", "_"), self.domain)


def _tell(line: str) -> None:
    print(line, flush=True)
