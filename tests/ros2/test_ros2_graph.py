"""A ROS 2 graph over Zenoh, between processes:
somebody else's program reads heights and state, and brings a robot.
"""

import contextlib
import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest
import ros_idl
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
DOMAIN = 91  # of DDS; nobody's default
LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo'/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<Peers><Peer address='localhost'/></Peers></Discovery></Domain></CycloneDDS>"
)
SENT = {f"/saltus/{name}": kind for name, (kind, _) in (HEIGHTS | OF_ROBOT).items()} | {
    "/tf": "tf2_msgs/msg/TFMessage"
}


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


def lines_of(process: "subprocess.Popen[str]") -> IO[str]:
    assert process.stdout is not None
    return process.stdout


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


@pytest.mark.sample(1)
@pytest.mark.parametrize("prefix", ["robot/0", "fleet/7"])
def test_another_program_reads_heights_depth_and_state_of_a_run(
    prefix: str, tmp_path: Path, ros_port: int
) -> None:
    said: Any = dict(SAID)
    asked = [part for topic, kind in SENT.items() for part in (topic, kind)]
    with (
        speaking(tmp_path, prefix),
        saltus_ros2(
            tmp_path, ros_port, *(["--prefix", prefix] if prefix == "fleet/7" else [])
        ) as exporter,
        program(str(PEER), str(ros_port), "read", *asked) as peer,
    ):
        assert next(lines_of(exporter)).startswith("the ROS side is open")
        read = read_all(peer, set(SENT))
    now_s = time.time()
    for topic in set(SENT) - {"/tf"}:
        # ROS counts from 1970
        assert now_s - PATIENCE_S < read[topic]["header"]["stamp"]["sec"] <= now_s
    state, heightmap, frame = (
        said["controller/state"],
        said["heightmap/heightmap"],
        said["camera/depth"],
    )
    grid = read["/saltus/elevation_map_raw"]
    assert (grid["layers"], grid["basic_layers"], grid["header"]["frame_id"]) == (
        ["elevation", "variance", "half_width"], ["elevation"], "base_yaw",
    )  # fmt: skip
    np.testing.assert_allclose(grid["data"][0]["data"][:30], heightmap.height[::-1], rtol=1e-6)
    np.testing.assert_allclose(
        grid["data"][1]["data"][:30], (heightmap.half_width_90[::-1] / 1.645) ** 2, rtol=1e-5
    )
    cloud = read["/saltus/heights"]
    table = np.array(cloud["data"], np.uint8).view(np.float32).reshape(30, 4)
    np.testing.assert_allclose(table[:, 2], heightmap.height, rtol=1e-6)
    image, info = read["/saltus/depth/image_rect_raw"], read["/saltus/depth/camera_info"]
    assert (image["encoding"], image["width"], image["height"]) == ("16UC1", 16, 48)
    pixels = np.array(image["data"], np.uint8).view(np.uint16).reshape(48, 16)
    np.testing.assert_array_equal(pixels, np.where(frame.depth == 65535, 0, frame.depth))
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
    np.testing.assert_allclose(
        rotation @ xyz(odometry["twist"]["twist"]["linear"]), state.velocity_base_in_world
    )
    np.testing.assert_allclose(
        xyz(odometry["twist"]["twist"]["angular"]), state.angular_velocity_base
    )
    frames = {
        each["child_frame_id"]: each["header"]["frame_id"] for each in read["/tf"]["transforms"]
    }
    assert (frames["base"], frames["base_yaw"], frames["camera"]) == ("odom", "base", "base")
    assert set(frames) == {"base", "base_yaw", "camera", *JOINTS}


def check_taken(body: Any, image: Any) -> None:
    """They are the robot of `ros_peer`, in our frames and order."""
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
    assert (image.fx, image.cx, image.cy) == (
        ros_peer.FOCAL,
        0.5 * ros_peer.WIDTH,
        0.5 * ros_peer.HEIGHT,
    )


def test_a_robot_that_speaks_ros_is_given_heights(tmp_path: Path, ros_port: int) -> None:
    """Its readings come to the service in our frames and order.

    What the service answers comes to it.
    """
    config = RunConfig(robot="go1", grid="line", pace="realtime")
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
        wanted = (
            "joints (/joint_states), imu (/imu/data), odometry (/odom), depth "
            "(/camera/depth/image_rect_raw)"
        )
        assert next(said) == f"waiting for {wanted}\n"
        later.enter_context(program(str(PEER), str(ros_port), "robot"))
        state, frame = states.wait(PATIENCE_S), frames.wait(PATIENCE_S)
        assert state is not None
        assert frame is not None
        while not next(said).startswith("the robot's state and images are complete"):
            pass
        over = threading.Event()

        def answer() -> None:
            while not over.wait(0.01):
                answers.put(heightmap)

        thread = threading.Thread(target=answer)
        thread.start()
        try:
            read = read_all(reader, {topic, "/tf"})
        finally:
            over.set()
            thread.join()
    check_taken(state.message, frame.message)
    np.testing.assert_allclose(
        read[topic]["data"][0]["data"][:30], heightmap.height[::-1], rtol=1e-6
    )
    frames_read = {
        each["child_frame_id"]: each["header"]["frame_id"] for each in read["/tf"]["transforms"]
    }
    assert frames_read == {"base_yaw": "base_link", "camera": "base_link"}


def test_others_see_the_node_its_topics_and_types(tmp_path: Path, ros_port: int) -> None:
    """Tokens as zenoh-ros2-sdk writes and reads them."""
    from zenoh_ros2_sdk.entity import EndpointEntity, EntityKind, NodeEntity
    from zenoh_ros2_sdk.keyexpr import (
        endpoint_liveliness_keyexpr,
        node_liveliness_keyexpr,
        topic_keyexpr,
    )

    settings = zenoh.Config()
    settings.insert_json5("mode", '"client"')
    settings.insert_json5("connect/endpoints", json.dumps([f"tcp/127.0.0.1:{ros_port}"]))
    with speaking(tmp_path), saltus_ros2(tmp_path, ros_port, "--domain", "7") as exporter:
        next(lines_of(exporter))
        told: set[str] = set()
        all_told = threading.Event()

        def note(sample: zenoh.Sample) -> None:
            told.add(str(sample.key_expr))
            if len(told) == 1 + len(SENT):  # the node and its topics
                all_told.set()

        # A router that has just let us in may not have heard of them yet, and would answer a `get`
        # with less
        with (
            zenoh.open(settings) as session,
            session.liveliness().declare_subscriber("@ros2_lv/7/**", note, history=True),
        ):
            assert all_told.wait(PATIENCE_S), told
            tokens = set(told)
    zid = next(iter(tokens)).split("/")[2]
    node = NodeEntity(domain_id=7, session_id=zid, node_id=0, node_name="saltus", namespace="/")
    expected = {node_liveliness_keyexpr(node)}
    entities = {
        token.split("/")[9]: int(token.split("/")[4]) for token in tokens if "/MP/" in token
    }
    assert len(set(entities.values())) == len(SENT)
    for topic, kind in SENT.items():
        mangled = topic.replace("/", "%")
        quality = QosProfile.decode(ros2_node.RELIABLE)
        assert quality.encode() == ros2_node.RELIABLE
        endpoint = EndpointEntity(
            node=node, entity_id=entities[mangled], kind=EntityKind.PUBLISHER, name=topic,
            dds_type_name=ros2_node.dds_name(kind), type_hash=ros_peer.hash_of(kind),
            qos=quality.encode(),
            gid=bytes(16),
        )  # fmt: skip
        expected.add(endpoint_liveliness_keyexpr(endpoint))
        key = ros2_node.topic_key(7, topic, kind, ros_peer.hash_of(kind))
        assert key == topic_keyexpr(7, topic, ros2_node.dds_name(kind), ros_peer.hash_of(kind))
    assert tokens == expected
    assert set(TYPES.values()) <= set(TEXTS)


def compiled(folder: Path) -> Path:
    """A peer in C with types that Debian's idlc 0.10.2 makes of the packages' texts."""
    (folder / "ros.idl").write_text(ros_idl.idl())
    subprocess.run(["/usr/bin/idlc", "ros.idl"], cwd=folder, check=True)
    order = [name.split("_")[1] for name in ros_peer.NAMES]
    values = {
        "NAMES": ",".join(f'"{name}"' for name in ros_peer.NAMES),
        "POSITIONS": ",".join(str(ros_peer.POSITION[link]) for link in order),
        "WIDTH": ros_peer.WIDTH, "HEIGHT": ros_peer.HEIGHT, "FOCAL": ros_peer.FOCAL,
        "VELOCITY": ros_peer.VELOCITY,
        "DEPTH_M": 1e-3 * ros_peer.DEPTH_MM,
        "TURN_Y": np.sin(0.5 * ros_peer.PITCH), "TURN_W": np.cos(0.5 * ros_peer.PITCH),
    }  # fmt: skip
    defined = [f"-D{name}={value}" for name, value in values.items()]
    source = str(Path(__file__).with_name("dds_peer.c"))
    subprocess.run(
        ["/usr/bin/gcc", "-I.", *defined, "-o", "peer", source, "ros.c", "-lddsc"],
        cwd=folder,
        check=True,
    )
    return folder / "peer"


def test_a_robot_on_cyclone_0_10_is_given_heights_and_survives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A type of Cyclone 11's own would end it with a segmentation fault."""
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    config = RunConfig(robot="go1", grid="line", pace="realtime")
    (put_run(tmp_path, config) / RUN_FILE).write_text(to_toml(config))
    endpoint, router = open_router()
    write_client(tmp_path / CLIENT_FILE, endpoint)
    heightmap: Any = dict(run_messages(0))["heightmap/heightmap"]
    peer = [str(compiled(tmp_path)), str(DOMAIN), "20"]
    with (
        contextlib.closing(router),
        ZenohBus(endpoint, config.prefix) as bus,
        saltus_ros2(tmp_path, 1, "--take", "--dds", "--domain", str(DOMAIN)) as bridge,
        subprocess.Popen(peer, stdout=subprocess.PIPE, text=True) as other,
    ):
        states, frames = bus.latest("controller/state"), bus.latest("camera/depth")
        answers = bus.publisher("heightmap/heightmap")
        assert f"domain {DOMAIN} of DDS reads what is sent here, and can feed" in next(
            lines_of(bridge)
        )
        state, frame = states.wait(PATIENCE_S), frames.wait(PATIENCE_S)
        until_s = time.monotonic() + PATIENCE_S
        while other.poll() is None and time.monotonic() < until_s:
            answers.put(heightmap)
            time.sleep(0.01)
        assert other.returncode == 0
        assert other.stdout is not None
        told = [line.split() for line in other.stdout]
    assert state is not None
    assert frame is not None
    check_taken(state.message, frame.message)
    variance = (heightmap.half_width_90[::-1] / 1.645) ** 2
    assert len(told) == 20
    for words in told:
        assert words[:3] == ["base_yaw", "elevation", "variance"]
        values = np.array(words[3:], dtype=np.float64).reshape(2, 2, 30)
        for column in range(2):
            np.testing.assert_allclose(values[0, column], heightmap.height[::-1], rtol=1e-6)
            np.testing.assert_allclose(values[1, column], variance, rtol=1e-5)


def test_types_that_dds_is_told_are_those_of_the_packages(tmp_path: Path) -> None:
    """Names and order of fields as in the texts; every uint8 an octet, which Cyclone 0.10 knows."""
    from saltus import dds_types

    for name, text in TEXTS.items():
        kind = dds_types.type_of(name)
        fields = [line.split()[1] for line in text.splitlines() if "=" not in line]
        assert list(kind.__annotations__) == fields
        assert kind.__idl_typename__.replace(".", "::") == ros2_node.dds_name(name)
    assert dds_types.BASE["uint8"] is dds_types.types.byte
