"""Velocity commands of ROS on the bus: what they say, and what strangers may send."""

import numpy as np
import pytest
from memory_bus import MemoryBus
from ros_texts import TEXTS
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from saltus.clock import RunClock
from saltus.config import RunConfig
from saltus.recordings import ros_messages as ros
from saltus.ros2.commands import TWIST, CommandReceiver
from saltus.wire.bus import RawSample, Slot
from saltus.wire.messages import CommandMode, DriveCommand
from saltus.wire.schemas import PLAN_VELOCITY


class Node:
    """A node of a ROS graph in which a test sends."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, str, str]] = []

    def subscribe(self, topic: str, type_name: str, type_hash: str, slot: Slot) -> None:
        self.asked.append((topic, type_name, type_hash))
        self.slot = slot

    def send(self, payload: bytes) -> None:
        self.slot.push(RawSample("/cmd_vel", payload, b"", 0))


class Stage:
    def __init__(self) -> None:
        self.node, bus = Node(), MemoryBus("robot/0")
        clock = RunClock.of(RunConfig(robot="go1", grid="line", pace="realtime"))
        self.receiver = CommandReceiver(bus, self.node, "/cmd_vel", clock)  # type: ignore[arg-type]
        self.commands = MemoryBus("robot/0", bus.hub).latest("operator/command")

    def told(self) -> DriveCommand | None:
        self.receiver.step()
        sample = self.commands.take()
        return None if sample is None else sample.message


def twist(x: float, y: float, turn: float) -> bytes:
    linear = ros.vector([x, y, 5.0])
    return ros.payload_of(ros.make(TWIST, linear=linear, angular=ros.vector([6.0, 7.0, turn])))


def test_it_subscribes_as_ros_knows_the_type() -> None:
    store = get_typestore(Stores.EMPTY)
    for each, text in TEXTS.items():
        store.register(get_types_from_msg(text, each))
    assert Stage().node.asked == [("/cmd_vel", TWIST, store.hash_rihs01(TWIST))]


def test_a_velocity_is_an_operators_wish_to_walk_so_and_the_newest_counts() -> None:
    rng, stage = np.random.default_rng(0), Stage()
    before_ns = 0
    for _ in range(50):
        sent = rng.uniform(-20.0, 20.0, (3, 3))
        for values in sent:
            stage.node.send(twist(*values))
        told = stage.told()
        assert told is not None
        expected = np.clip(sent[-1], -PLAN_VELOCITY, PLAN_VELOCITY).tolist()
        assert [told.velocity_x, told.velocity_y, told.yaw_rate] == expected
        assert (told.mode, told.step) == (CommandMode.WALK, -1)
        assert told.time_ns >= before_ns
        before_ns = told.time_ns
        assert stage.told() is None  # said once: who sends nothing more lets it grow old


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("place", range(3))
def test_what_is_no_number_moves_nobody(value: float, place: int) -> None:
    stage, values = Stage(), [0.1, 0.2, 0.3]
    values[place] = value
    stage.node.send(twist(*values))
    assert stage.told() is None
    assert stage.receiver.rejected == {"not_finite": 1}


def test_bytes_that_are_no_twist_are_counted_and_others_go_on() -> None:
    rng, stage = np.random.default_rng(1), Stage()
    good = twist(0.5, 0.0, 0.0)
    for length in range(0, len(good), 5):
        stage.node.send(good[:length])
        assert stage.told() is None
    stage.node.send(good)
    told = stage.told()
    assert told is not None
    assert told.velocity_x == 0.5
    assert sum(stage.receiver.rejected.values()) == len(range(0, len(good), 5))
    for _ in range(50):
        stage.node.send(rng.bytes(int(rng.integers(0, 80))))
        stage.told()
