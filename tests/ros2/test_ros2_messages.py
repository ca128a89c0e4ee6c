"""Messages from and to ROS: type hashes, what comes back of what was sent,
and what strangers may send.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import ros_peer
from memory_bus import MemoryBus
from recorded import MS, STEPS, run_messages
from ros_frames import LOCKSTEP, frame_messages
from ros_texts import TEXTS
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from samples import ROBOT

from saltus.config import RunConfig
from saltus.errors import ConfigError
from saltus.recordings import ros_messages as ros
from saltus.robots.loading import load_robot
from saltus.robots.robot import JOINTS
from saltus.robots.shipped import shipped_robots
from saltus.ros2.bridge import RosReceiver
from saltus.ros2.incoming import HELD_S, TYPES, RosIntake
from saltus.ros2.outgoing import HEIGHTS, EstimatedWay, RosExporter
from saltus.ros2.outgoing import ROBOT as OF_ROBOT
from saltus.ros2.wall_clock import WallClock
from saltus.rotations import rotation_matrix
from saltus.wire.cdr import make_ros_header

USED = {
    *TYPES.values(),
    *(kind for kind, _ in (HEIGHTS | OF_ROBOT).values()),
    "tf2_msgs/msg/TFMessage",
}


NOW_NS = 10**10


OF_JOINTS = ("joint_position", "joint_velocity", "joint_torque")


@pytest.mark.parametrize("name", sorted(USED))
def test_type_hashes_are_those_that_others_compute_from_the_packages_texts(name: str) -> None:
    store = get_typestore(Stores.EMPTY)
    for each, text in TEXTS.items():
        store.register(get_types_from_msg(text, each))
    assert ros.hash_of(name) == store.hash_rihs01(name) == ros_peer.hash_of(name)


def test_hashes_are_those_that_a_running_ros_was_seen_with() -> None:
    """From logs of rmw_zenoh and of ROS 2 Jazzy."""
    known = {
        "sensor_msgs/msg/Image": "d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
        "sensor_msgs/msg/PointCloud2": "9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
        "nav_msgs/msg/Odometry": "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    }
    assert {name: ros.hash_of(name) for name in known} == {
        name: f"RIHS01_{digits}" for name, digits in known.items()
    }


def imu_of(state: Any, *, attitude: bool = True) -> Any:
    covariance = np.zeros(9)
    covariance[0] = 0.0 if attitude else -1.0
    turned = state.quaternion_base_in_world if attitude else np.array([1.0, 0.0, 0.0, 0.0])
    return ros.make(
        "sensor_msgs/msg/Imu", header=make_ros_header(state.time_ns, "imu"),
        orientation=ros.quaternion(turned),
        orientation_covariance=covariance, angular_velocity=ros.vector(state.angular_velocity_base),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=ros.vector(state.acceleration_base),
        linear_acceleration_covariance=np.zeros(9),
    )  # fmt: skip


def give(intake: RosIntake, state: Any, names: list[str], **imu: bool) -> None:
    messages = {
        "joints": ros.joint_state(state.time_ns, names, state),
        "imu": imu_of(state, **imu),
        "odometry": ros.odometry(state.time_ns, "base", np.zeros(3), state),
    }
    for kind, message in messages.items():
        assert intake.take(kind, ros.payload_of(message), state.time_ns) is None


@pytest.mark.parametrize("name", shipped_robots())
@pytest.mark.parametrize("attitude", [True, False])
def test_a_state_that_goes_to_ros_and_back_is_the_same(name: str, attitude: bool) -> None:
    """In whatever order their joints come, counted their way,
    with attitude from IMU or odometry.
    """
    rng, robot = np.random.default_rng(3), load_robot(name)
    for sign in (np.ones(12), np.where(rng.random(12) < 0.5, -1.0, 1.0)):
        theirs = replace(robot, joint_sign=sign)
        order = rng.permutation(12)
        intake = RosIntake(theirs, LOCKSTEP)
        for step in range(10):
            before: Any = dict(run_messages(step))["controller/state"]
            sent = replace(before, time_ns=NOW_NS + step * 10 * MS)
            told = replace(
                sent, **{field: (sign * getattr(sent, field))[order] for field in OF_JOINTS}
            )
            give(intake, told, [f"{JOINTS[i]}_joint" for i in order], attitude=attitude)
            state: Any = intake.state(sent.time_ns)
            for field in (*OF_JOINTS, "angular_velocity_base", "acceleration_base"):
                np.testing.assert_allclose(
                    getattr(state, field), getattr(sent, field), rtol=1e-12, err_msg=field
                )
            for field in ("velocity_base_in_world", "quaternion_base_in_world"):
                np.testing.assert_allclose(
                    getattr(state, field), getattr(sent, field), rtol=1e-9, atol=1e-12
                )
            assert (state.step, state.time_ns) == (step, sent.time_ns)
        assert not intake.rejected


@pytest.mark.parametrize("base_height_m", [None, 0.25, 0.6])
@pytest.mark.parametrize("place", [np.zeros(3), np.array([3.0, -1.0, 0.4])])
def test_a_robot_with_other_legs_needs_no_joints_and_its_odometry_says_where_it_is(
    place: np.ndarray, base_height_m: float | None
) -> None:
    """A position that nobody has set is none; how high the base stands is said, or the robot's."""
    intake = RosIntake(ROBOT, LOCKSTEP, has_joints=False, base_height_m=base_height_m)
    sent: Any = replace(dict(run_messages(0))["controller/state"], time_ns=NOW_NS)  # type: ignore[arg-type]
    assert intake.missing(NOW_NS) == ["imu", "odometry"]
    for kind, message in (
        ("imu", imu_of(sent)),
        ("odometry", ros.odometry(NOW_NS, "base", place, sent)),
    ):
        intake.take(kind, ros.payload_of(message), NOW_NS)
    state = intake.state(NOW_NS)
    assert state is not None
    assert state.base_height == (base_height_m or ROBOT.stand_height)
    np.testing.assert_allclose(
        state.position_base_in_odometry, place if place.any() else np.zeros(0)
    )
    np.testing.assert_allclose(
        state.velocity_base_in_world, sent.velocity_base_in_world, atol=1e-12
    )
    assert not state.leg_trusted.any()


def test_readings_that_are_old_are_not_used_and_said_to_be_missing() -> None:
    intake, sent = (
        RosIntake(ROBOT, LOCKSTEP),
        replace(dict(run_messages(0))["controller/state"], time_ns=NOW_NS),
    )  # type: ignore[arg-type]
    assert intake.missing(NOW_NS) == ["joints", "imu", "odometry"]
    give(intake, sent, list(JOINTS))
    late_ns = NOW_NS + round(1e9 * HELD_S)
    assert intake.missing(late_ns) == []
    assert intake.state(late_ns) is not None
    assert intake.missing(late_ns + 1) == ["joints", "imu", "odometry"]
    assert intake.state(late_ns + 1) is None


@pytest.mark.parametrize("off_s", [-1.0, 1e3, -1e9])
def test_steady_stamps_of_another_clock_are_refused_and_counted_unless_arrival_is_taken(
    off_s: float,
) -> None:
    sent: Any = replace(dict(run_messages(0))["controller/state"], time_ns=2 * 10**18)  # type: ignore[arg-type]
    payload = ros.payload_of(imu_of(replace(sent, time_ns=10**9)))
    now_ns = 10**9 + round(1e9 * off_s) if off_s > 0 else round(1e9 * (1.0 + off_s))
    refusing, taking = RosIntake(ROBOT, LOCKSTEP), RosIntake(ROBOT, LOCKSTEP, arrival=True)
    refusing.take("imu", payload, now_ns)
    taking.take("imu", payload, now_ns)
    assert (dict(refusing.rejected), refusing.missing(now_ns)) == (
        {"imu/clock": 1},
        ["joints", "imu", "odometry"],
    )
    assert (dict(taking.rejected), taking.missing(now_ns)) == ({}, ["joints", "odometry"])


def test_what_is_refused_is_told_while_it_goes_on_and_not_again_and_again() -> None:
    class Silent:
        def subscribe(self, *_: object) -> None:
            pass

    intake, told = RosIntake(ROBOT, LOCKSTEP), list[str]()
    node, topics = Silent(), dict.fromkeys(TYPES, "/it")
    bus = MemoryBus("robot/0")
    receiver = RosReceiver(bus, node, intake, topics, None, told.append)  # type: ignore[arg-type]
    for now_s, refused in ((0.0, 0), (1.0, 3), (2.5, 4), (5.0, 0), (7.5, 1)):
        if refused:
            intake.rejected["joints/clock"] += refused
        receiver._say(["joints"], now_s)
    intake.rejected["depth/encoding"] += 1
    receiver._say([], 7.6)
    advice = "stamps are not this computer's time: --arrival-times takes messages as they arrive"
    assert told == [
        "waiting for joints (/it)",
        f"waiting for joints (/it); refused so far: 7 joints/clock; {advice}",
        f"waiting for joints (/it); refused so far: 8 joints/clock; {advice}",
        "the robot's state and images are complete; refused so far: 8 joints/clock, 1 "
        f"depth/encoding; {advice}",
    ]


def test_what_strangers_send_is_counted_and_never_raises() -> None:
    """Bytes that are cut, flipped, of another type, or say what cannot be."""
    rng, intake = np.random.default_rng(8), RosIntake(ROBOT, LOCKSTEP)
    state: Any = dict(run_messages(0))["controller/state"]
    _, image, info = frame_messages()
    good = {
        "depth": image, "camera_info": info, "joints": ros.joint_state(0, list(JOINTS), state),
        "imu": imu_of(state),
        "odometry": ros.odometry(0, "base", np.zeros(3), state),
    }  # fmt: skip
    payloads = {kind: ros.payload_of(message) for kind, message in good.items()}
    for kind, payload in payloads.items():
        for other in payloads.values():
            intake.take(kind, other, 0)
        for _ in range(200):
            data = bytearray(payload[: rng.integers(0, len(payload) + 1)])
            for place in rng.integers(0, max(1, len(data)), size=rng.integers(0, 6)):
                if data:
                    data[place] = rng.integers(0, 256)
            intake.take(kind, bytes(data), 0)
            intake.state(0)
    assert sum(intake.rejected.values()) > 500
    for bad in (
        replace(image, encoding="rgb8"), replace(image, width=17),
        replace(image, step=1), replace(image, height=0, data=np.zeros(0, np.uint8)),
    ):  # fmt: skip
        fresh = RosIntake(ROBOT, LOCKSTEP)
        fresh.take("camera_info", payloads["camera_info"], 0)
        assert fresh.take("depth", ros.payload_of(bad), 0) is None
        assert sum(fresh.rejected.values()) == 1
    nameless = replace(good["joints"], name=["a"] * 12)
    fresh.take("joints", ros.payload_of(nameless), 0)
    assert fresh.rejected["joints/joint_names"] == 1
    with pytest.raises(ConfigError, match="2 names of joints"):
        RosIntake(ROBOT, LOCKSTEP, ("a", "b"))


def test_times_of_ros_and_of_a_run_at_any_speed_are_turned_into_each_other() -> None:
    for speed in (0.1, 0.5, 1.0):
        clock = WallClock(
            RunConfig(robot="go1", grid="line", pace="realtime", speed=speed, epoch_ns=123_456_789)
        )
        for run_ns in (0, 10**9, 10**12):
            assert clock.run_ns(clock.wall_ns(run_ns)) == pytest.approx(run_ns, abs=2)
        assert clock.wall_ns(10**9) - clock.wall_ns(0) == pytest.approx(10**9 / speed, abs=2)


def test_frames_for_ros_say_the_attitude_and_only_the_yaw() -> None:
    """base in odom is turned as the IMU says, base_yaw by the yaw alone, whatever the attitude."""
    exporter = RosExporter(ROBOT, LOCKSTEP)
    for step in range(STEPS):
        state: Any = dict(run_messages(step))["controller/state"]
        (frames,) = (out.message for out in exporter.of_state(state) if out.topic == "/tf")
        turned = {
            each.child_frame_id: rotation_matrix(np.array([r.w, r.x, r.y, r.z]))
            for each in frames.transforms
            for r in [each.transform.rotation]
        }
        np.testing.assert_allclose(
            turned["base"], rotation_matrix(state.quaternion_base_in_world), atol=1e-12
        )
        level = turned["base"] @ turned["base_yaw"]
        np.testing.assert_allclose(level[:, 2], [0.0, 0.0, 1.0], atol=1e-12)
        ahead = turned["base"][:2, 0]
        np.testing.assert_allclose(level[:2, 0], ahead / np.linalg.norm(ahead), atol=1e-12)


def test_the_way_is_the_sum_of_velocities_and_a_gap_adds_nothing() -> None:
    way, expected = EstimatedWay(), np.array([0.0, 0.0, 0.27])
    state: Any = dict(run_messages(0))["controller/state"]
    rng = np.random.default_rng(2)
    time_ns = 0
    np.testing.assert_allclose(way.go(replace(state, time_ns=0)), expected)
    for step in range(50):
        gap_ns = 5 * 10**9 if step == 20 else 10 * MS
        velocity, time_ns = rng.normal(size=3), time_ns + gap_ns
        expected = expected + (0.0 if step == 20 else 0.01) * velocity
        np.testing.assert_allclose(
            way.go(replace(state, time_ns=time_ns, velocity_base_in_world=velocity)), expected
        )
