"""Between the bus of a run and a ROS 2 graph:
what is sent, what is taken, and what is missing for it.
"""

import math
import time
from collections.abc import Callable, Iterable, Mapping

from saltus.clock import RunClock
from saltus.constants import POLICY_DT
from saltus.recordings import ros_messages as ros
from saltus.ros2.commands import CommandReceiver
from saltus.ros2.incoming import RosIntake
from saltus.ros2.outgoing import TRANSFORMS, OutgoingRosMessage, RosExporter
from saltus.wire.bus import Bus, Slot
from saltus.wire.messages import DepthFrame, Heightmap, RobotState
from saltus.wire.ros2_node import RosNode, RosPublisher

WAIT_S = 0.1  # how often it looks whether both routers answer
IMAGES_WITHIN_S = 1.0  # of real time: a run may be slowed
AGAIN_S = 2.0  # between two lines while messages are refused
ADVICE = {
    "clock": "stamps are not this computer's time: --arrival-times takes messages as they arrive",
    "depth_unit": "depth images of 32 bit are too far in metres: "
    "--depth-unit-m 0.001 takes them as millimetres",
}
"""Advice of reasons for which messages are refused."""


class RosSender:
    """Sends what comes on the bus to ROS."""

    def __init__(self, bus: Bus, node: RosNode, exporter: RosExporter, namespace: str) -> None:
        self._exporter = exporter
        self._latests = [
            bus.latest(name) for name in ("controller/state", "camera/depth", "heightmap/heightmap")
        ]
        names = {TRANSFORMS: "tf2_msgs/msg/TFMessage"} | exporter.topics
        self._publishers: dict[str, RosPublisher] = {
            name: node.publisher(full_name(namespace, name), kind, ros.hash_of(kind))
            for name, kind in names.items()
        }

    def step(self) -> None:
        """Sends the newest of each topic, if it has not been sent."""
        for latest in self._latests:
            sample = latest.take()
            if sample is not None:
                for out in self._made_of(sample.message):
                    self._publishers[out.topic].put(ros.payload_of(out.message), time.time_ns())

    def _made_of(self, message: object) -> Iterable[OutgoingRosMessage]:
        if isinstance(message, RobotState):
            return self._exporter.of_state(message)
        if isinstance(message, DepthFrame):
            return self._exporter.of_frame(message)
        return self._exporter.of_heightmap(message) if isinstance(message, Heightmap) else ()


class RosReceiver:
    """Puts what comes from ROS on the bus: images as they come, states at the rate of the service.

    Args:
        bus: Of the run, to which nobody else tells of a robot.
        node: In the ROS graph.
        intake: Makes our messages of theirs.
        topics: Name in ROS of each kind that is taken, see `RosIntake.take`.
        clock: Of the run.
        tell: Is told in one line what is missing, whenever that changes, and of what is refused
            while it goes on.
    """

    def __init__(
        self, bus: Bus, node: RosNode, intake: RosIntake, topics: Mapping[str, str],
        clock: RunClock,
        tell: Callable[[str], None],
    ) -> None:  # fmt: skip
        self._intake = intake
        self._topics = topics
        self._clock = clock
        self._tell = tell
        self._told: list[str] | None = None
        self._counted: dict[str, int] = {}
        self._told_s = -math.inf
        self._next_s = time.monotonic()
        self._slots = {kind: Slot(bus.bell) for kind in topics}
        for kind, slot in self._slots.items():
            of_kind = intake.type_of(kind)
            node.subscribe(topics[kind], of_kind, ros.hash_of(of_kind), slot)
        self._states = bus.publisher("controller/state")
        images = [kind for kind in topics if kind.partition("/")[0] == "depth"]
        self._frames = {
            kind: bus.publisher("camera/depth", kind.partition("/")[2]) for kind in images
        }
        self._image_s = dict.fromkeys(images, -math.inf)

    def step(self) -> float:
        """Takes what has come, and sends a state if one is due.

        Returns the time until the next is [s].
        """
        for kind, slot in self._slots.items():
            while (raw := slot.pop()) is not None:
                frame = self._intake.take(kind, raw.payload, self._clock.now_ns())
                if frame is not None:
                    self._image_s[kind] = time.monotonic()
                    self._frames[kind].put(frame)
        now_s = time.monotonic()
        if now_s >= self._next_s:
            self._next_s = max(self._next_s + POLICY_DT, now_s)
            now_ns = self._clock.now_ns()
            state = self._intake.state(now_ns)
            if state is not None:
                self._states.put(state)
            late = [kind for kind, at in self._image_s.items() if now_s - at > IMAGES_WITHIN_S]
            self._say([*self._intake.missing(now_ns), *late], now_s)
        return self._next_s - time.monotonic()

    def _say(self, missing: list[str], now_s: float) -> None:
        rejected = self._intake.rejected
        more = rejected != self._counted and now_s - self._told_s > AGAIN_S
        if missing == self._told and not more:
            return
        advice = {
            ADVICE[reason] for name in rejected if (reason := name.rpartition("/")[2]) in ADVICE
        }
        self._told, self._told_s, self._counted = missing, now_s, dict(rejected)
        names = ", ".join(f"{kind} ({self._topics[kind]})" for kind in missing)
        refused = ", ".join(f"{count} {name}" for name, count in rejected.items())
        said = [f"waiting for {names}" if missing else "the robot's state and images are complete"]
        self._tell(
            "; ".join(
                [*said, *([f"refused so far: {refused}"] if refused else []), *sorted(advice)]
            )
        )


def run_bridge(
    bus: Bus,
    node: RosNode,
    sender: RosSender,
    receiver: RosReceiver | None,
    commands: CommandReceiver | None = None,
) -> None:
    """Sends and takes until the router of the run or that of ROS is gone."""
    while bus.connected() and node.connected():
        looked_s = time.monotonic()
        while time.monotonic() - looked_s < WAIT_S:
            heard = bus.bell.rings
            sender.step()
            if commands is not None:
                commands.step()
            wait_s = WAIT_S if receiver is None else max(0.0, receiver.step())
            bus.bell.wait(heard, min(wait_s, WAIT_S))


def full_name(namespace: str, name: str) -> str:
    """A topic below the namespace; what begins with a slash is not below it."""
    return name if name.startswith("/") else f"/{namespace.strip('/')}/{name}".replace("//", "/")
