"""A ROS 2 graph over Zenoh, between processes: somebody else's program reads heights and state, and brings a robot."""

import contextlib
import json
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ros_peer
import zenoh
from recorded import run_messages
from ros_texts import TEXTS
from samples import KINEMATICS, ROBOT, put_run
from speaker import SAID, speaking
from zenoh_ros2_sdk.qos import QosProfile

from saltus.config import RunConfig, to_toml
from saltus.robots.robot import JOINTS
from saltus.ros2.incoming import TYPES
from saltus.ros2.outgoing import HEIGHTS
from saltus.ros2.outgoing import ROBOT as OF_ROBOT
from saltus.rotations import rotation_matrix
from saltus.runtime.run_folder import CLIENT_FILE, RUN_FILE
from saltus.wire import ros2_node
from saltus.wire.joining import write_client
from saltus.wire.router import open_router
from saltus.wire.zenoh_bus import ZenohBus

PATIENCE_S = 60.0
PEER = Path(ros_peer.__file__)
SENT = {f"/saltus/{name}": kind for name, (kind, _) in (HEIGHTS | OF_ROBOT).items()} | {"/tf": "tf2_msgs/msg/TFMessage"}


@pytest.fixture
def ros_port() -> Iterator[int]:
    """Of a router as rmw_zenohd is one."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    settings = zenoh.Config()
    settings.insert_json5("mode", '"router"')
    settings.insert_json5("listen/endpoints", json.dumps([f"tcp/127.0.0.1:{port}"]))
    settings.insert_json5("scouting/multicast/enabled", "false")
    session = zenoh.open(settings)
    yield port
    session.close()


@contextlib.contextmanager
def program(*command: str) -> Iterator["subprocess.Popen[str]"]:
    with subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.terminate()


def saltus_ros2(folder: Path, port: int, *more: str) -> Any:
    command = ("-P", "-m", "saltus.cli.main", "ros2", "--run-dir", str(folder))
    return program(*command, "--ros-router", f"tcp/127.0.0.1:{port}", *more)


def lines_of(process: "subprocess.Popen[str]") -> Iterator[str]:
    assert process.stdout is not None
    yield from process.stdout


def read_all(process: "subprocess.Popen[str]", topics: set[str]) -> dict[str, Any]:
    """The first message of each topic that another program prints."""
    found: dict[str, Any] = {}
    until_s = time.monotonic() + PATIENCE_S
    for line in lines_of(process):
        topic, message = json.loads(line)
        found.setdefault(topic, message)
        if set(found) >= topics or time.monotonic() > until_s:
            break
    assert set(found) == topics
    return found


def xyz(vector: Any) -> list[float]:
    return [vector["x"], vector["y"], vector["z"]]


def test_another_program_reads_heights_depth_and_state_of_a_run(tmp_path: Path, ros_port: int) -> None:
    said: Any = dict(SAID)
    asked = [part for topic, kind in SENT.items() for part in (topic, kind)]
    with (
        speaking(tmp_path),
        saltus_ros2(tmp_path, ros_port) as exporter,
        program(str(PEER), str(ros_port), "read", *asked) as peer,
    ):
        assert next(lines_of(exporter)).startswith("the ROS side is open")
        read = read_all(peer, set(SENT))
    now_s = time.time()
    for topic in set(SENT) - {"/tf"}:
        assert now_s - PATIENCE_S < read[topic]["header"]["stamp"]["sec"] <= now_s  # ROS counts from 1970
    state, heightmap, frame = said["controller/state"], said["heightmap/heightmap"], said["camera/depth"]
    grid = read["/saltus/elevation_map_raw"]
    assert (grid["layers"], grid["basic_layers"], grid["header"]["frame_id"]) == (
        ["elevation", "variance"], ["elevation"], "base_yaw",
    )  # fmt: skip
    np.testing.assert_allclose(grid["data"][0]["data"][:30], heightmap.height[::-1], rtol=1e-6)
    np.testing.assert_allclose(grid["data"][1]["data"][:30], (heightmap.half_width_90[::-1] / 1.645) ** 2, rtol=1e-5)
    cloud = read["/saltus/heights"]
    table = np.array(cloud["data"], np.uint8).view(np.float32).reshape(30, 4)
    np.testing.assert_allclose(table[:, 2], heightmap.height, rtol=1e-6)
    image, info = read["/saltus/depth/image_rect_raw"], read["/saltus/depth/camera_info"]
    assert (image["encoding"], image["width"], image["height"]) == ("16UC1", 16, 48)
    np.testing.assert_array_equal(np.array(image["data"], np.uint8).view(np.uint16).reshape(48, 16), frame.depth)
    np.testing.assert_allclose([info["k"][0], info["k"][2]], [frame.fx, frame.cx - 0.5])
    joints = read["/saltus/joint_states"]
    assert joints["name"] == list(JOINTS)
    np.testing.assert_allclose(joints["position"], state.joint_position)
    np.testing.assert_allclose(joints["velocity"], state.joint_velocity)
    np.testing.assert_allclose(joints["effort"], state.joint_torque)
    odometry = read["/saltus/odom"]
    assert (odometry["header"]["frame_id"], odometry["child_frame_id"]) == ("odom", "base")
    turned = odometry["pose"]["pose"]["orientation"]
    np.testing.assert_allclose([turned["w"], *xyz(turned)], state.quaternion_base_in_world)
    rotation = rotation_matrix(state.quaternion_base_in_world)
    np.testing.assert_allclose(rotation @ xyz(odometry["twist"]["twist"]["linear"]), state.velocity_base_in_world)
    np.testing.assert_allclose(xyz(odometry["twist"]["twist"]["angular"]), state.angular_velocity_base)
    frames = {each["child_frame_id"]: each["header"]["frame_id"] for each in read["/tf"]["transforms"]}
    assert (frames["base"], frames["base_yaw"], frames["camera"]) == ("odom", "base", "base")
    assert set(frames) == {"base", "base_yaw", "camera", *JOINTS}


def test_a_robot_that_speaks_ros_is_given_heights(tmp_path: Path, ros_port: int) -> None:
    """What it says comes to the service in our frames and order; what the service answers comes to it."""
    config = RunConfig(pace="realtime")
    (put_run(tmp_path, config) / RUN_FILE).write_text(to_toml(config))
    endpoint, router = open_router()
    write_client(tmp_path / CLIENT_FILE, endpoint)
    heightmap: Any = dict(run_messages(0))["heightmap/heightmap"]
    topic = "/saltus/elevation_map_raw"
    with (
        contextlib.closing(router),
        ZenohBus(endpoint, config.prefix) as bus,
        saltus_ros2(tmp_path, ros_port, "--take", "--base-frame", "base_link") as bridge,
        contextlib.ExitStack() as later,
        program(str(PEER), str(ros_port), "read", topic, SENT[topic], "/tf", SENT["/tf"]) as reader,
    ):
        states, frames, answers = (
            bus.latest("controller/state"),
            bus.latest("camera/depth"),
            bus.publisher("heightmap/heightmap"),
        )
        said = lines_of(bridge)
        assert "can feed the heights" in next(said)
        assert next(said) == "waiting for joints (/joint_states), imu (/imu/data), odometry (/odom)\n"
        later.enter_context(program(str(PEER), str(ros_port), "robot"))
        state, frame = states.wait(PATIENCE_S), frames.wait(PATIENCE_S)
        assert state is not None
        assert frame is not None
        while not next(said).startswith("the robot's state is complete"):
            pass
        for _ in range(100):
            answers.put(heightmap)
            time.sleep(0.01)
        read = read_all(reader, {topic, "/tf"})
    body, image = state.message, frame.message
    position = [ros_peer.POSITION[name.split("_")[1]] for name in JOINTS]
    np.testing.assert_allclose(body.joint_position, position)
    turned = [np.cos(0.5 * ros_peer.PITCH), 0.0, np.sin(0.5 * ros_peer.PITCH), 0.0]
    np.testing.assert_allclose(body.quaternion_base_in_world, turned)
    ahead = [np.cos(ros_peer.PITCH), 0.0, -np.sin(ros_peer.PITCH)]
    np.testing.assert_allclose(body.velocity_base_in_world, ros_peer.VELOCITY * np.array(ahead))
    np.testing.assert_allclose(body.angular_velocity_base, [0.0, 0.0, 0.2])
    feet = KINEMATICS.position(np.array(position)) @ rotation_matrix(np.array(turned)).T
    assert body.base_height == pytest.approx(ROBOT.foot_radius - feet[:, 2].min())
    assert image.depth.shape == (ros_peer.HEIGHT, ros_peer.WIDTH)
    assert (image.depth == ros_peer.DEPTH_MM).all()
    assert (image.fx, image.cx, image.cy) == (ros_peer.FOCAL, 0.5 * ros_peer.WIDTH, 0.5 * ros_peer.HEIGHT)
    np.testing.assert_allclose(read[topic]["data"][0]["data"][:30], heightmap.height[::-1], rtol=1e-6)
    frames_read = {each["child_frame_id"]: each["header"]["frame_id"] for each in read["/tf"]["transforms"]}
    assert frames_read == {"base_yaw": "base_link", "camera": "base_link"}


def test_others_see_the_node_its_topics_and_types(tmp_path: Path, ros_port: int) -> None:
    """Tokens as zenoh-ros2-sdk writes and reads them."""
    from zenoh_ros2_sdk.entity import EndpointEntity, EntityKind, NodeEntity
    from zenoh_ros2_sdk.keyexpr import endpoint_liveliness_keyexpr, node_liveliness_keyexpr, topic_keyexpr

    settings = zenoh.Config()
    settings.insert_json5("mode", '"client"')
    settings.insert_json5("connect/endpoints", json.dumps([f"tcp/127.0.0.1:{ros_port}"]))
    with speaking(tmp_path), saltus_ros2(tmp_path, ros_port, "--domain", "7") as exporter:
        next(lines_of(exporter))
        with zenoh.open(settings) as session:
            tokens = {str(reply.ok.key_expr) for reply in session.liveliness().get("@ros2_lv/7/**")}
    zid = next(iter(tokens)).split("/")[2]
    node = NodeEntity(domain_id=7, session_id=zid, node_id=0, node_name="saltus", namespace="/")
    expected = {node_liveliness_keyexpr(node)}
    entities = {token.split("/")[9]: int(token.split("/")[4]) for token in tokens if "/MP/" in token}
    assert len(set(entities.values())) == len(SENT)
    for topic, kind in SENT.items():
        mangled = topic.replace("/", "%")
        quality = QosProfile.decode(ros2_node.RELIABLE)
        assert quality.encode() == ros2_node.RELIABLE
        endpoint = EndpointEntity(
            node=node, entity_id=entities[mangled], kind=EntityKind.PUBLISHER, name=topic,
            dds_type_name=ros2_node.dds_name(kind), type_hash=ros_peer.hash_of(kind), qos=quality.encode(),
            gid=bytes(16),
        )  # fmt: skip
        expected.add(endpoint_liveliness_keyexpr(endpoint))
        key = ros2_node.topic_key(7, topic, kind, ros_peer.hash_of(kind))
        assert key == topic_keyexpr(7, topic, ros2_node.dds_name(kind), ros_peer.hash_of(kind))
    assert tokens == expected
    assert set(TYPES.values()) <= set(TEXTS)
