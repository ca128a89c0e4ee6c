"""A robot of your own on the bus, without Saltus:
it sends its state and depth images, and is told heights.

    pip install eclipse-zenoh numpy rosbags
    saltus router --out runs/mine                       # one terminal
    saltus heightmap serve --run-dir runs/mine          # another
    python examples/own_robot.py runs/mine/client.json5

Here the robot stands still on level ground, and its camera sees just that: put your own readings in
their place. Payloads are CDR of the ROS 2 messages below, times those of this computer's monotonic
clock [ns].
"""

import argparse
import contextlib
import itertools
import json
import math
import os
import struct
import time
from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import zenoh
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

DEFINITIONS = {
    "saltus_msgs/msg/RobotState": """std_msgs/Header header
int64 step
float64[4] quaternion_base_in_world
float64[3] angular_velocity_base
float64[3] acceleration_base
float64[12] joint_position
float64[12] joint_velocity
float64[12] joint_torque
float64[3] velocity_base_in_world
float64 base_height
bool[4] leg_contact
float64[4] leg_progress
bool[4] leg_trusted
int64 cycle
uint8 mode
int64 depth_due
float64[] position_base_in_odometry
float64[] standing_feet
""",
    "saltus_msgs/msg/DepthFrame": """std_msgs/Header header
sensor_msgs/Image image
sensor_msgs/CameraInfo camera_info
float64 depth_unit_m
int64 frame_id
""",
    "saltus_msgs/msg/Heightmap": """std_msgs/Header header
int64 step
float64[] x
float64[] y
float64[] height
float64[] half_width_90
uint8 status
float64 depth_age_s
int64 frame_id
string model_id
float64 seen_share
float64[] age_s
string dialect
float64[] observation
""",
}
STATUS = ("ok", "warming up", "degraded", "invalid")
PERIOD_S, LATENCY_S = 0.01, 0.05
BASE_HEIGHT_M = 0.285  # as the legs below stand
CAMERA_HEIGHT_M, CAMERA_PITCH = BASE_HEIGHT_M + 0.092, 0.52  # 30 degrees nose down
WIDTH, HEIGHT, FOCAL = 80, 240, 211.313  # [px]

store = get_typestore(Stores.ROS2_JAZZY)
for name, text in DEFINITIONS.items():
    store.register(get_types_from_msg(text, name))


def make(kind: str, **fields: object) -> object:
    """A ROS 2 message."""
    return store.types[kind](**fields)


def header(time_ns: int) -> object:
    """With the moment at which the thing was true."""
    stamp = make("builtin_interfaces/msg/Time", sec=time_ns // 10**9, nanosec=time_ns % 10**9)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id="")


class Publisher:
    """Sends messages of one type, each with its number, its capture time and who sends it."""

    def __init__(self, session: zenoh.Session, key: str, kind: str) -> None:
        self.kind, self.count, self.sender = kind, 0, os.urandom(16)
        # Never wait for a slow reader
        self.publisher = session.declare_publisher(
            key, congestion_control=zenoh.CongestionControl.DROP, express=True
        )

    def put(self, time_ns: int, **fields: object) -> None:
        """Sends one."""
        self.count += 1
        message = make(self.kind, header=header(time_ns), **fields)
        attachment = struct.pack("<qqB16s", self.count, time_ns, 16, self.sender)
        self.publisher.put(bytes(store.serialize_cdr(message, self.kind)), attachment=attachment)


def level_ground() -> np.ndarray:
    """Depth along the optical axis [mm], shape (240, 80)."""
    down = (
        np.arange(HEIGHT) + 0.5 - 0.5 * HEIGHT
    ) / FOCAL  # of each row of pixels, per metre of depth
    drop = np.sin(CAMERA_PITCH) + down * np.cos(CAMERA_PITCH)
    depth = np.where(drop > 0.0, CAMERA_HEIGHT_M / np.maximum(drop, 1e-3), np.inf)
    # 65535: nothing within range; 0: invalid
    millimetres = np.where(depth < 10.0, 1e3 * np.minimum(depth, 10.0), 65535)
    return np.repeat(np.rint(millimetres)[:, None], WIDTH, axis=1).astype(np.uint16)


def image_fields(depth: np.ndarray, time_ns: int, focal: float = FOCAL) -> dict[str, object]:
    """The image and its intrinsics, as in ROS:
    pixel (u, v) looks through ((u - cx) / fx, (v - cy) / fy).
    """
    height, width = depth.shape
    intrinsics = np.array(
        [focal, 0.0, 0.5 * width - 0.5, 0.0, focal, 0.5 * height - 0.5, 0.0, 0.0, 1.0]
    )
    region = make(
        "sensor_msgs/msg/RegionOfInterest",
        x_offset=0,
        y_offset=0,
        height=0,
        width=0,
        do_rectify=False,
    )
    image = make(
        "sensor_msgs/msg/Image", header=header(time_ns), height=height, width=width,
        encoding="16UC1",
        is_bigendian=0, step=2 * width, data=depth.view(np.uint8).ravel(),
    )  # fmt: skip
    info = make(
        "sensor_msgs/msg/CameraInfo", header=header(time_ns), height=height, width=width,
        distortion_model="plumb_bob",
        d=np.zeros(5), k=intrinsics, r=np.eye(3).ravel(), p=np.insert(intrinsics, [3, 6, 9], 0.0),
        binning_x=0, binning_y=0, roi=region,
    )  # fmt: skip
    return {"image": image, "camera_info": info, "depth_unit_m": 0.001}


def standing() -> dict[str, object]:
    """Returns what a robot that stands tells.

    The network reads the attitude, the rate of turn, the velocity, the height of the base above its
    feet, and the joint angles of the legs that are trusted to stand; it does not read the rest.
    """
    return {
        "quaternion_base_in_world": np.array([1.0, 0.0, 0.0, 0.0]),  # w, x, y, z
        "angular_velocity_base": np.zeros(3),
        "acceleration_base": np.array([0.0, 0.0, 9.81]),
        "joint_position": np.tile([0.0, 0.9, -1.8], 4),  # hip, thigh, calf of FR, FL, RR, RL
        "joint_velocity": np.zeros(12),
        "joint_torque": np.zeros(12),
        "velocity_base_in_world": np.zeros(3),
        "base_height": BASE_HEIGHT_M,
        "leg_contact": np.ones(4, np.bool_),
        "leg_progress": np.full(4, 0.5),
        "leg_trusted": np.ones(4, np.bool_),
        "cycle": 0,
        "mode": 0,
        "depth_due": -1,
        "position_base_in_odometry": np.zeros(0),  # or x, y, z, if your odometry has them
        "standing_feet": np.zeros(
            0
        ),  # or x, y, z of the ground under each, if the legs are not a Go1's
    }


def arguments(description: str | None) -> argparse.ArgumentParser:
    """The arguments of a robot on the bus."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("client", help="client.json5 of the run")
    parser.add_argument("--prefix", default="robot/0", help="of the keys")
    parser.add_argument(
        "--seconds", type=float, default=math.inf, help="how long; by default until Ctrl-C"
    )
    return parser


def ticks(seconds: float) -> Iterator[tuple[int, int]]:
    """Waits for each step of 10 ms in turn; its number and its time [ns]."""
    start = time.monotonic_ns()
    for step in itertools.takewhile(lambda step: step * PERIOD_S < seconds, itertools.count()):
        time.sleep(max(0.0, 1e-9 * (start - time.monotonic_ns()) + PERIOD_S * step))
        yield step, time.monotonic_ns()


def main() -> None:
    """Sends at 100 Hz and prints twice a second what is ahead.

    One JSON line a heightmap with --json.
    """
    parser = arguments(__doc__)
    parser.add_argument(
        "--json", action="store_true", help="print every heightmap as one line of JSON"
    )
    options = parser.parse_args()
    session = zenoh.open(zenoh.Config.from_file(options.client))
    states = Publisher(session, f"{options.prefix}/controller/state", "saltus_msgs/msg/RobotState")
    frames = Publisher(session, f"{options.prefix}/camera/depth", "saltus_msgs/msg/DepthFrame")

    def receive(sample: zenoh.Sample) -> None:
        heights = store.deserialize_cdr(sample.payload.to_bytes(), "saltus_msgs/msg/Heightmap")
        if options.json:
            names = ("step", "x", "height", "half_width_90", "status")
            fields = SimpleNamespace(
                **{name: np.asarray(getattr(heights, name)).tolist() for name in names}
            )
            print(json.dumps(vars(fields)), flush=True)
        elif heights.step % 50 == 0:
            pairs = zip(heights.height[10::5], heights.half_width_90[10::5], strict=True)
            ahead = [f"{height:+.3f} +- {half_width:.3f}" for height, half_width in pairs]
            print(f"{STATUS[heights.status]}: {', '.join(ahead)} m", flush=True)

    subscriber = session.declare_subscriber(f"{options.prefix}/heightmap/heightmap", receive)
    depth = level_ground()
    with contextlib.suppress(KeyboardInterrupt):
        for step, now_ns in ticks(options.seconds):
            if step % 2 == 0:
                taken_ns = now_ns - round(1e9 * LATENCY_S)
                frames.put(taken_ns, frame_id=step // 2, **image_fields(depth, taken_ns))
            states.put(now_ns, step=step, **standing())
        time.sleep(0.2)
    subscriber.undeclare()
    session.close()


if __name__ == "__main__":
    main()
