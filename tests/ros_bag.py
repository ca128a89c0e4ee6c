"""Writes a run log as a robot of ROS would have recorded it."""

from pathlib import Path
from typing import Any

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

from saltus.recordings.run_log import RunLog
from saltus.rotations import rotation_matrix

STORES = {"ros1": get_typestore(Stores.ROS1_NOETIC), "ros2": get_typestore(Stores.ROS2_HUMBLE)}


class RosBag:
    """A bag that is being written; `kind` is sqlite3, mcap or ros1."""

    def __init__(self, path: Path, kind: str) -> None:
        self.is_ros1 = kind == "ros1"
        self.store = STORES["ros1" if self.is_ros1 else "ros2"]
        if self.is_ros1:
            self.writer: Any = rosbag1.Writer(path)
        else:
            self.writer = rosbag2.Writer(
                path, version=9, storage_plugin=rosbag2.StoragePlugin[kind.upper()]
            )
        self.topics: dict[str, Any] = {}

    def __enter__(self) -> "RosBag":
        self.writer.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.close()

    def make(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def header(self, time_s: float) -> Any:
        sec, nanosec = divmod(round(1e9 * time_s), 10**9)
        stamp = self.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        return self.make(
            "std_msgs/msg/Header", stamp=stamp, frame_id="", **({"seq": 0} if self.is_ros1 else {})
        )

    def put(
        self, topic: str, kind: str, time_s: float, arrival_s: float | None = None, **fields: Any
    ) -> None:
        if topic not in self.topics:
            self.topics[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        message = self.make(kind, header=self.header(time_s), **fields)
        serialize = self.store.serialize_ros1 if self.is_ros1 else self.store.serialize_cdr
        at_ns = round(1e9 * (time_s if arrival_s is None else arrival_s))
        self.writer.write(self.topics[topic], at_ns, serialize(message, kind))

    def xyz(self, kind: str, values: np.ndarray) -> Any:
        return self.make(
            f"geometry_msgs/msg/{kind}", **dict(zip("xyz", map(float, values), strict=True))
        )

    def turn(self, wxyz: np.ndarray) -> Any:
        w, x, y, z = map(float, wxyz)
        return self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def write_bag(log: RunLog, path: Path, kind: str = "mcap", *, has_commands: bool = True) -> Path:
    """Joints in the order of the alphabet and with names that end in _joint,
    as robots of ROS have them.
    """
    with RosBag(path, kind) as bag:
        put_joints(bag, log, has_commands)
        put_turns(bag, log)
        for time_s, row in _rows(log.base):
            put_odometry(bag, time_s, row)
        _put_images(bag, log)
    return path


def _rows(table: Any) -> Any:
    return zip(table.time_s, table.values, strict=True) if table is not None else ()


def put_joints(bag: RosBag, log: RunLog, has_commands: bool) -> None:
    joints, none = log.joints, np.zeros(0)
    order = np.argsort(log.meta["joints"])
    names = [f"{log.meta['joints'][i]}_joint" for i in order]
    topics = {
        "/joint_states": ("q", "dq", "tau_est"),
        "/joint_commands": ("q_des", "dq_des", "tau_ff"),
    }
    for row, (time_s, arrival_s) in enumerate(
        zip(joints.time_s, np.sort(joints.time_s), strict=True)
    ):
        for topic, signals in list(topics.items())[: 1 + has_commands]:
            values = [getattr(joints, name) for name in signals]
            fields = [none if each is None else each[row, order] for each in values]
            parts = dict(zip(("position", "velocity", "effort"), fields, strict=True))
            bag.put(topic, "sensor_msgs/msg/JointState", time_s, arrival_s, name=names, **parts)


def put_turns(bag: RosBag, log: RunLog) -> None:
    """Those of the IMU."""
    unknown = np.zeros(9)
    for time_s, row in _rows(log.imu):
        bag.put(
            "/imu", "sensor_msgs/msg/Imu", time_s, orientation=bag.turn(row[:4]),
            orientation_covariance=unknown,
            angular_velocity=bag.xyz("Vector3", row[4:7]), angular_velocity_covariance=unknown,
            linear_acceleration=bag.xyz("Vector3", row[7:]), linear_acceleration_covariance=unknown,
        )  # fmt: skip


def put_odometry(bag: RosBag, time_s: float, row: np.ndarray) -> None:
    own = rotation_matrix(row[3:7]).T @ row[7:]
    twist = bag.make(
        "geometry_msgs/msg/Twist",
        linear=bag.xyz("Vector3", own),
        angular=bag.xyz("Vector3", np.zeros(3)),
    )
    pose = bag.make(
        "geometry_msgs/msg/Pose", position=bag.xyz("Point", row[:3]), orientation=bag.turn(row[3:7])
    )
    bag.put(
        "/odom", "nav_msgs/msg/Odometry", time_s, child_frame_id="trunk",
        pose=bag.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
        twist=bag.make("geometry_msgs/msg/TwistWithCovariance", twist=twist,
            covariance=np.zeros(36)),
    )  # fmt: skip


def _put_images(bag: RosBag, log: RunLog) -> None:
    """Depth, and a colour image that must not be taken for it."""
    depth, camera = log.depth, log.meta.get("camera")
    if depth is None or camera is None or depth.capture_s is None:
        return
    height, width = depth.depth_mm.shape[1:]
    k = np.array(
        [camera["fx"], 0, camera["cx"] - 0.5, 0, camera["fy"], camera["cy"] - 0.5, 0, 0, 1.0]
    )
    matrices = {"D": np.zeros(5), "K": k, "R": np.eye(3).ravel(), "P": np.insert(k, [3, 6, 9], 0.0)}
    if not bag.is_ros1:
        matrices = {name.lower(): values for name, values in matrices.items()}
    region = bag.make(
        "sensor_msgs/msg/RegionOfInterest",
        x_offset=0,
        y_offset=0,
        height=0,
        width=0,
        do_rectify=False,
    )
    for capture_s, arrival_s, image in zip(
        depth.capture_s, depth.arrival_s, depth.depth_mm, strict=True
    ):
        stamps = (float(capture_s), float(arrival_s))
        colour = np.zeros((height, width, 3), np.uint8)
        for folder, encoding, pixels in (("depth", "16UC1", image), ("colour", "rgb8", colour)):
            bag.put(
                f"/{folder}/image", "sensor_msgs/msg/Image", *stamps, height=height, width=width,
                encoding=encoding,
                is_bigendian=0, step=pixels[0].nbytes,
                data=np.ascontiguousarray(pixels).view(np.uint8).ravel(),
            )  # fmt: skip
            bag.put(
                f"/{folder}/camera_info", "sensor_msgs/msg/CameraInfo", *stamps, height=height,
                width=width,
                distortion_model="plumb_bob", **matrices, binning_x=0, binning_y=0, roi=region,
            )  # fmt: skip
