"""A program of ROS 2's world that knows nothing of Saltus:
zenoh-ros2-sdk, with definitions passed in.

python ros_peer.py PORT read TOPIC TYPE ...          # prints one line of JSON for each message
python ros_peer.py PORT robot                        # publishes a robot that stands on level ground
"""

import json
import sys
import threading
import time
from typing import Any

import numpy as np
from ros_texts import TEXTS
from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber
from zenoh_ros2_sdk.session import ZenohSession
from zenoh_ros2_sdk.utils import get_type_hash

NAMES = [
    f"{leg}_{link}_joint" for leg in ("FL", "FR", "RL", "RR") for link in ("hip", "thigh", "calf")
]
"""Another order than ours."""
POSITION = {"hip": 0.05, "thigh": 0.9, "calf": -1.8}
VELOCITY = 0.5  # [m/s] ahead
PITCH = 0.1  # nose down [rad]
LOCK = threading.Lock()
WIDTH, HEIGHT, FOCAL, DEPTH_MM = 16, 48, 40.0, 700


def hash_of(name: str) -> str:
    return str(get_type_hash(name, TEXTS[name], TEXTS))


def session(port: int) -> Any:
    """A session that knows all types."""
    found = ZenohSession.get_instance("127.0.0.1", port)
    for name, text in TEXTS.items():
        found.register_message_type(text, name)
    return found


def plain(value: Any) -> Any:
    """What JSON can say."""
    if hasattr(value, "__dataclass_fields__"):
        return {
            name: plain(getattr(value, name))
            for name in value.__dataclass_fields__
            if name != "__msgtype__"
        }
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [plain(item) for item in value] if isinstance(value, list) else value


def read(port: int, topics: list[str]) -> None:
    session(port)
    for topic, name in zip(topics[::2], topics[1::2], strict=True):

        def tell(message: Any, topic: str = topic) -> None:
            with LOCK:  # the SDK calls from a thread of each topic
                sys.stdout.write(f"{json.dumps([topic, plain(message)])}\n")
                sys.stdout.flush()

        ROS2Subscriber(
            topic, name, tell, msg_definition=TEXTS[name], router_ip="127.0.0.1", router_port=port,
            type_hash=hash_of(name),
        )  # fmt: skip
    time.sleep(600.0)


def robot(port: int) -> None:
    types = session(port).store.types
    names = {
        "/camera/depth/camera_info": "sensor_msgs/msg/CameraInfo",
        "/camera/depth/image_rect_raw": "sensor_msgs/msg/Image",
        "/joint_states": "sensor_msgs/msg/JointState",
        "/imu/data": "sensor_msgs/msg/Imu",
        "/odom": "nav_msgs/msg/Odometry",
    }
    publishers = {
        topic: ROS2Publisher(
            topic,
            name,
            msg_definition=TEXTS[name],
            router_ip="127.0.0.1",
            router_port=port,
            type_hash=hash_of(name),
        )
        for topic, name in names.items()
    }

    def make(name: str, **fields: Any) -> Any:
        return types[name](**fields)

    def vector(x: float, y: float, z: float) -> Any:
        return make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)

    joints = np.array([POSITION[name.split("_")[1]] for name in NAMES])
    turned = make(
        "geometry_msgs/msg/Quaternion", x=0.0, y=np.sin(0.5 * PITCH), z=0.0, w=np.cos(0.5 * PITCH)
    )
    region = make(
        "sensor_msgs/msg/RegionOfInterest",
        x_offset=0,
        y_offset=0,
        height=0,
        width=0,
        do_rectify=False,
    )
    pose = make(
        "geometry_msgs/msg/Pose",
        position=make("geometry_msgs/msg/Point", x=1.0, y=2.0, z=3.0),
        orientation=turned,
    )
    twist = make(
        "geometry_msgs/msg/Twist", linear=vector(VELOCITY, 0.0, 0.0), angular=vector(0.0, 0.0, 0.0)
    )
    k = np.array([FOCAL, 0.0, 0.5 * WIDTH - 0.5, 0.0, FOCAL, 0.5 * HEIGHT - 0.5, 0.0, 0.0, 1.0])
    while True:
        seconds, nanoseconds = divmod(time.time_ns(), 10**9)
        stamp = make("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
        head = make("std_msgs/msg/Header", stamp=stamp, frame_id="their_frame")
        publishers["/camera/depth/camera_info"].publish(
            header=head, height=HEIGHT, width=WIDTH, distortion_model="plumb_bob", d=np.zeros(5),
            k=k,
            r=np.eye(3).ravel(), p=np.zeros(12), binning_x=0, binning_y=0, roi=region,
        )  # fmt: skip
        pixels = np.full((HEIGHT, WIDTH), 1e-3 * DEPTH_MM, np.float32)
        publishers["/camera/depth/image_rect_raw"].publish(
            header=head, height=HEIGHT, width=WIDTH, encoding="32FC1", is_bigendian=0,
            step=4 * WIDTH,
            data=pixels.view(np.uint8).ravel(),
        )  # fmt: skip
        publishers["/joint_states"].publish(
            header=head, name=NAMES, position=joints, velocity=np.zeros(12), effort=np.zeros(0)
        )
        publishers["/imu/data"].publish(
            header=head, orientation=turned, orientation_covariance=np.zeros(9),
            angular_velocity=vector(0.0, 0.0, 0.2),
            angular_velocity_covariance=np.zeros(9), linear_acceleration=vector(0.0, 0.0, 9.81),
            linear_acceleration_covariance=np.zeros(9),
        )  # fmt: skip
        publishers["/odom"].publish(
            header=head, child_frame_id="base_link",
            pose=make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
            twist=make("geometry_msgs/msg/TwistWithCovariance", twist=twist,
                covariance=np.zeros(36)),
        )  # fmt: skip
        time.sleep(0.02)


if __name__ == "__main__":
    if sys.argv[2] == "read":
        read(int(sys.argv[1]), sys.argv[3:])
    else:
        robot(int(sys.argv[1]))
