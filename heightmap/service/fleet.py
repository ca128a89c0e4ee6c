"""The heightmap service of several robots: one hidden state each,
one call of the network for all that ask at once.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from saltus.heightmap.service.image_watch import DEPTH, less_trusted
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.service import HeightmapService
from saltus.heightmap.service.sight import NetworkInputs, NetworkOutputs
from saltus.wire.bus import Sample
from saltus.wire.messages import DepthFrame, Heightmap, RobotState
from saltus.wire.topics import Topic

TAKEOVER_NS = 3_000_000_000
"""A model that is to take over must have become as good as the running one in this time: far more
than its warm-up (below half a second), and longer than a short outage of the camera."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotRequest:
    """One robot's request to a service of several robots: its state and its newest image."""

    state: RobotState
    robot_boot: bytes
    """Drawn anew each time that the process which sends the states is started."""
    frame: DepthFrame | None
    """Image that has arrived since the robot last asked."""
    camera_boot: bytes | None
    """Drawn anew each time that the process which sends the frames is started; None without a
    frame."""
    now_ns: int
    """The clock of the robot's run."""
    others: Mapping[str, Sample] = field(default_factory=dict)
    """Images of further cameras that have arrived since, by camera."""

    @property
    def images(self) -> Iterator[tuple[str, DepthFrame, bytes]]:
        """Name, image and start of the process of each camera that has sent one.

        The first has no name.
        """
        if self.frame is not None and self.camera_boot is not None:
            yield "", self.frame, self.camera_boot
        for name, sample in self.others.items():
            yield name, sample.message, sample.envelope.boot_id


class _Robot:
    """The service in use for one robot, and the one that is to replace it."""

    def __init__(self, network: HeightmapNetwork, depth: Topic) -> None:
        self.service = HeightmapService(network, depth)
        self.coming: HeightmapService | None = None
        self.coming_since_ns: int | None = None
        self._robot_boot: bytes | None = None
        self._camera_boot: bytes | None = None

    @property
    def services(self) -> list[HeightmapService]:
        """The service in use, and the coming one if there is one."""
        return [self.service] if self.coming is None else [self.service, self.coming]

    def accept(self, arrival: RobotRequest) -> None:
        """Empties hidden states where the robot was restarted.

        Images of a camera that was are counted anew.
        """
        if arrival.robot_boot != self._robot_boot:
            self._robot_boot = arrival.robot_boot
            for service in self.services:
                service.reset()
        if arrival.camera_boot is not None and arrival.camera_boot != self._camera_boot:
            known, self._camera_boot = self._camera_boot, arrival.camera_boot
            for service in self.services if known is not None else ():
                service.new_camera()

    def take_over(self) -> bool:
        """Lets the coming service replace the one in use as soon as its answer is worth as much."""
        coming, used = self.coming, self.service
        if coming is None or coming.last is None or used.last is None:
            return False
        if less_trusted(coming.last.status, used.last.status) != used.last.status:
            return False
        if used.warm and not coming.warm:  # without images both are INVALID
            return False
        self.service, self.coming = coming, None
        return True

    def give_up(self, now_ns: int) -> bool:
        """Drops the coming service when its time is over."""
        if self.coming is None:
            return False
        if self.coming_since_ns is None:
            self.coming_since_ns = now_ns
        if now_ns - self.coming_since_ns <= TAKEOVER_NS:
            return False
        self.coming = None
        return True


class FleetService:
    """Answers the states of several robots, by name, and waits for none of them.

    Each robot has a hidden state of its own, which is emptied when that robot is restarted, and
    never because of another robot. `depth` says how old images may be.
    """

    def __init__(
        self, network: HeightmapNetwork, robots: Iterable[str], depth: Topic = DEPTH
    ) -> None:
        self._depth = depth
        self._robots = {robot: _Robot(network, depth) for robot in robots}
        self.swaps = 0
        """How often a robot has got another model."""
        self.given_up = 0
        """How often a robot has kept its model because another one did not become as good."""

    def use(self, network: HeightmapNetwork) -> None:
        """Gives another model to all robots.

        It runs beside the one in use and replaces it, robot by robot, when its hidden state is
        warm: each robot has heights all the time. Where its answers do not become as good within
        three seconds, it is dropped.
        """
        for robot in self._robots.values():
            robot.coming, robot.coming_since_ns = HeightmapService(network, self._depth), None

    def step(self, arrivals: Mapping[str, RobotRequest]) -> dict[str, Heightmap]:
        """Answers those robots that ask, by name, each as `HeightmapService.step` would."""
        asked: list[tuple[HeightmapService, RobotRequest, NetworkInputs]] = []
        for name, arrival in arrivals.items():
            self._robots[name].accept(arrival)
            for service in self._robots[name].services:
                inputs = service.prepare(arrival.state, arrival.frame, arrival.now_ns)
                if inputs is not None:
                    asked.append((service, arrival, inputs))
        for network in {id(service.network): service.network for service, _, _ in asked}.values():
            batch = [item for item in asked if item[0].network is network]
            ticks = _run(network, [inputs for _, _, inputs in batch])
            for (service, arrival, inputs), tick in zip(batch, ticks, strict=True):
                service.finish(arrival.state, inputs, tick, arrival.now_ns)
        return {
            name: self._answer(self._robots[name], arrival) for name, arrival in arrivals.items()
        }

    def _answer(self, robot: _Robot, arrival: RobotRequest) -> Heightmap:
        if robot.take_over():
            self.swaps += 1
        elif robot.give_up(arrival.now_ns):
            self.given_up += 1
        assert robot.service.last is not None  # noqa: S101 - it has been asked
        return robot.service.last


def _run(network: HeightmapNetwork, asked: list[NetworkInputs]) -> list[NetworkOutputs]:
    """One call of the network for all, each of whom is one robot."""
    if len(asked) == 1:
        return [network.tick(*asked[0])]
    together = network.tick(*map(np.concatenate, zip(*asked, strict=True)))
    return [together._replace(values=row[None]) for row in together.values]
