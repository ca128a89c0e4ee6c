"""Any robot on the bus, without Saltus: it sends states and depth images,
and is told 187 heights and an observation.

    pip install eclipse-zenoh numpy rosbags
    saltus router --grid scan --camera examples/scan_camera.toml --out runs/mine   # one terminal
    saltus heightmap serve --run-dir runs/mine --dialect isaaclab --body none      # another
    python examples/scan_robot.py runs/mine/client.json5

Here a robot without known legs goes over level ground at 0.3 m/s, 0.4 m above it, and its camera
sees just that: put your own readings in the place of `attitude_and_velocity` and `depth_image`.
Everything else is the format.
"""

import contextlib
import time

import numpy as np
import zenoh
from own_robot import LATENCY_S, STATUS, Publisher, arguments, image_fields, standing, store, ticks

SPEED_MPS, BASE_HEIGHT_M = 0.3, 0.4
CAMERA_HEIGHT_M, CAMERA_PITCH = BASE_HEIGHT_M + 0.05, 0.61  # as in scan_camera.toml
WIDTH, HEIGHT, FOCAL = 212, 120, 111.6  # [px]: 87 x 57 degrees


def attitude_and_velocity(seconds: float) -> dict[str, object]:
    """Returns what the odometry of your robot says; a position is optional, and so are feet."""
    return {
        "quaternion_base_in_world": np.array([1.0, 0.0, 0.0, 0.0]),  # w, x, y, z
        "angular_velocity_base": np.zeros(3),  # [rad/s]
        "velocity_base_in_world": np.array([SPEED_MPS, 0.0, 0.0]),  # [m/s]
        "position_base_in_odometry": np.array(
            [SPEED_MPS * seconds, 0.0, BASE_HEIGHT_M]
        ),  # or np.zeros(0)
        "standing_feet": np.zeros(
            0
        ),  # x, y, z in the base frame of the ground under each foot that surely stands
        "base_height": BASE_HEIGHT_M,  # of the base above the ground when it stands, roughly [m]
        "leg_trusted": np.zeros(4, np.bool_),  # of the legs of a robot that Saltus has a model of
    }


def depth_image() -> np.ndarray:
    """Depth along the optical axis [mm], uint16, 0 where there is none, shape (120, 212)."""
    down = (np.arange(HEIGHT) + 0.5 - 0.5 * HEIGHT) / FOCAL
    drop = np.sin(CAMERA_PITCH) + down * np.cos(CAMERA_PITCH)
    depth = np.where(drop > 0.0, CAMERA_HEIGHT_M / np.maximum(drop, 1e-3), np.inf)
    millimetres = np.where(depth < 6.0, 1e3 * np.minimum(depth, 6.0), 0.0)
    return np.repeat(np.rint(millimetres)[:, None], WIDTH, axis=1).astype(np.uint16)


def main() -> None:
    """Sends at 100 Hz and prints twice a second what is told."""
    options = arguments(__doc__).parse_args()
    session = zenoh.open(zenoh.Config.from_file(options.client))
    states = Publisher(session, f"{options.prefix}/controller/state", "saltus_msgs/msg/RobotState")
    frames = Publisher(session, f"{options.prefix}/camera/depth", "saltus_msgs/msg/DepthFrame")

    printed = [0]

    def receive(sample: zenoh.Sample) -> None:
        told = store.deserialize_cdr(sample.payload.to_bytes(), "saltus_msgs/msg/Heightmap")
        if told.step >= printed[0] + 50:
            printed[0] = told.step
            table = told.height.reshape(len(told.x), len(told.y))  # rows ahead, columns to the left
            ahead = table[len(told.x) // 2 :: 2, len(told.y) // 2]
            print(
                f"{STATUS[told.status]}: {told.height.size} heights, {100 * told.seen_share:.0f} % "
                "seen, half-width "
                f"{np.median(told.half_width_90):.3f} m; ahead "
                f"{', '.join(f'{z:+.3f}' for z in ahead)} m; "
                f"{told.dialect or 'no'} observation "
                f"{', '.join(f'{o:+.2f}' for o in told.observation[:4])} ...",
                flush=True,
            )

    subscriber = session.declare_subscriber(f"{options.prefix}/heightmap/heightmap", receive)
    depth, start = depth_image(), time.monotonic_ns()
    with contextlib.suppress(KeyboardInterrupt):
        for step, now_ns in ticks(options.seconds):
            if step % 3 == 0:  # images at a third of the rate of states
                taken_ns = now_ns - round(1e9 * LATENCY_S)
                frames.put(taken_ns, frame_id=step // 3, **image_fields(depth, taken_ns, FOCAL))
            states.put(
                now_ns, step=step, **(standing() | attitude_and_velocity(1e-9 * (now_ns - start)))
            )
        time.sleep(0.2)
    subscriber.undeclare()
    session.close()


if __name__ == "__main__":
    main()
