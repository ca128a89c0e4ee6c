"""Commands and states of a Go2 over DDS: of its own side, of ours, and of whoever only listens."""

import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any
from uuid import UUID

from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsParticipant,
    BuiltinTopicDcpsPublication,
)
from cyclonedds.core import (
    DDSException,
    InstanceState,
    Listener,
    Policy,
    Qos,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from saltus.controller.robot.unitree.messages import LOW_COMMAND, LOW_STATE
from saltus.controller.robot.unitree.truth import TRUTH
from saltus.dds_types import raw_type_of
from saltus.errors import StackError

COMMANDS, STATES, TRUTHS = "rt/lowcmd", "rt/lowstate", "rt/simulated_robot"
REQUESTS, ANSWERS = "rt/api/motion_switcher/request", "rt/api/motion_switcher/response"
REQUEST_TYPE, ANSWER_TYPE = "unitree_api/msg/Request", "unitree_api/msg/Response"
TYPES = {
    COMMANDS: LOW_COMMAND.type_name, STATES: LOW_STATE.type_name, TRUTHS: TRUTH.type_name,
    REQUESTS: REQUEST_TYPE, ANSWERS: ANSWER_TYPE,
}  # fmt: skip
"""Topics and the types that they carry; `TRUTHS` is a simulated robot's alone."""
DOMAIN_MAX = 232  # of DDS: ports of higher ones do not exist
LOOPBACK = "lo"
INTERFACE = re.compile(r"[\w.:@-]{1,15}")  # names of Linux: IFNAMSIZ is 16 with its end
DEPTH = 5000
"""States that wait for who is late: 10 s."""
TAKEN_AT_A_TIME = 100
FOUND_AT_A_TIME = 100
MEETING_S = 0.5
"""Others are met within this: they answer at once whoever joins."""
SETTINGS = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='{interface}'/></Interfaces>"
    "{more}</Domain></CycloneDDS>"
)
ON_NETWORK = "</General>"
# A loopback interface has no multicast: participants find each other by their ports
ON_LOOPBACK = (
    "<AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
    "<Peers><Peer address='localhost'/></Peers></Discovery>"
)


@dataclass(frozen=True, slots=True)
class ArrivedMessage:
    """A DDS message as it came, with its times."""

    payload: bytes
    arrival_ns: int
    """When it was taken, on the monotonic clock of this computer."""
    sent_ns: int
    """When it was sent, by its sender, since 1970."""


class UnitreeLink:
    """One participant in a robot's DDS domain, which sends and takes its messages.

    Args:
        domain: Number of the domain: 0 on a robot.
        interface: Network interface, "lo" within this computer; None as CYCLONEDDS_URI has it.
        sends: Topics that are sent.
        takes: Topics that are taken.
        heard: Called by a thread of DDS with each message at once, in the order in which they come;
            `take` then finds none.
        reliable: Lets senders wait for what is taken, where nothing may be lost.

    Raises:
        StackError: there is no such domain or interface.
    """

    @classmethod
    def to_robot(
        cls, domain: int, interface: str | None = None, *, reliable: bool = False
    ) -> "UnitreeLink":
        """A link that commands a robot and asks its motion service; arguments as of the class."""
        takes = [STATES, ANSWERS]
        return cls(domain, interface, sends=[COMMANDS, REQUESTS], takes=takes, reliable=reliable)

    def __init__(
        self,
        domain: int,
        interface: str | None = None,
        *,
        sends: Sequence[str] = (),
        takes: Sequence[str] = (),
        heard: Callable[[str, ArrivedMessage], None] | None = None,
        reliable: bool = False,
    ) -> None:
        if not 0 <= domain <= DOMAIN_MAX:
            raise StackError(f"DDS domain {domain}: allowed is 0 to {DOMAIN_MAX}")
        if interface is not None and not INTERFACE.fullmatch(interface):
            raise StackError(
                f"network interface '{interface}': `ip link` names those that are there"
            )
        try:
            self._domain = None if interface is None else _domain(domain, interface)
            self._participant: Any = DomainParticipant(domain)
        except DDSException as error:
            raise StackError(
                f"DDS cannot be joined in domain {domain} over {interface or 'any interface'}: "
                "`ip link` names the interfaces that are there"
            ) from error
        writes = Qos(Policy.Reliability.Reliable(duration(seconds=0)), Policy.History.KeepLast(1))
        policy: Any = Policy.Reliability
        quality = policy.Reliable(duration(seconds=1)) if reliable else policy.BestEffort
        reads = Qos(quality, Policy.History.KeepLast(DEPTH), Policy.IgnoreLocal.Participant)
        self._writers = {
            name: DataWriter(self._participant, self._topic(name), qos=writes) for name in sends
        }
        self._readers = {
            name: DataReader(
                self._participant,
                self._topic(name),
                qos=reads,
                listener=None if heard is None else _Intake(name, heard),
            )
            for name in takes
        }
        self._waits = {name: self._waiting(reader) for name, reader in self._readers.items()}
        self._publications: Any = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        self._participants: Any = BuiltinDataReader(self._participant, BuiltinTopicDcpsParticipant)
        self._publishers: dict[UUID, tuple[str, UUID]] = {}
        self._names: dict[UUID, str] = {}
        self._joined_s = time.monotonic()

    @property
    def has_met_all(self) -> bool:
        """True when those who were there before have had the time to answer."""
        return time.monotonic() - self._joined_s > MEETING_S

    def send(self, topic: str, payload: bytes) -> None:
        """Sends a message; it never waits.

        Raises:
            StackError: the network does not take it.
        """
        writer = self._writers[topic]
        sample = object.__new__(writer.data_type)
        sample.payload = payload
        try:
            writer.write(sample)
        except DDSException as error:
            raise StackError(f"{topic} cannot be sent: {error}") from error

    def take(self, topic: str) -> list[ArrivedMessage]:
        """The messages that have come since the last call, the oldest first."""
        return _taken(self._readers[topic])

    def wait(self, topic: str, seconds: float) -> None:
        """Returns when a message waits to be taken, or after some seconds."""
        self._waits[topic].wait(duration(seconds=seconds))

    def others(self, topic: str) -> tuple[str, ...]:
        """Programs besides this that publish a topic, by name, process and computer."""
        for found in self._participants.take(N=FOUND_AT_A_TIME):
            if _alive(found):
                self._names[found.key] = _name(found.qos)
        for found in self._publications.take(N=FOUND_AT_A_TIME):
            if _alive(found):
                self._publishers[found.key] = (found.topic_name, found.participant_key)
            else:
                self._publishers.pop(found.key, None)
        mine = self._participant.guid
        return tuple(
            self._names.get(owner, f"participant {owner}")
            for name, owner in self._publishers.values()
            if name == topic and owner != mine
        )

    def close(self) -> None:
        """Leaves the domain. May be called twice."""
        for reader in self._readers.values():
            reader.set_listener(None)
        self._writers, self._readers, self._waits = {}, {}, {}
        self._publications = self._participants = self._participant = self._domain = None

    def _waiting(self, reader: Any) -> WaitSet:
        waits = WaitSet(self._participant)
        waits.attach(ReadCondition(reader, SampleState.Any | ViewState.Any | InstanceState.Any))
        return waits

    def _topic(self, name: str) -> Any:
        return Topic(self._participant, name, raw_type_of(TYPES[name]))


class _Intake(Listener):
    """Hands on what comes."""

    def __init__(self, topic: str, heard: Callable[[str, ArrivedMessage], None]) -> None:
        super().__init__()
        self._topic, self._heard = topic, heard

    def on_data_available(self, reader: Any) -> None:
        for arrived in _taken(reader):
            self._heard(self._topic, arrived)


def _taken(reader: Any) -> list[ArrivedMessage]:
    """All that waits in a reader."""
    samples = new = reader.take(N=TAKEN_AT_A_TIME)
    while len(new) == TAKEN_AT_A_TIME:
        new = reader.take(N=TAKEN_AT_A_TIME)
        samples += new
    now_ns = time.monotonic_ns()
    return [
        ArrivedMessage(sample.payload, now_ns, int(sample.sample_info.source_timestamp))
        for sample in samples
        if hasattr(sample, "payload")  # else it says that a sender has gone
    ]


def _domain(number: int, interface: str) -> Domain | None:
    """The domain on one interface; None where this process is in it already."""
    more = ON_LOOPBACK if interface == LOOPBACK else ON_NETWORK
    try:
        return Domain(number, SETTINGS.format(interface=interface, more=more))
    except DDSException as error:
        if error.code == DDSException.DDS_RETCODE_PRECONDITION_NOT_MET:
            return None
        raise


def _alive(found: Any) -> bool:
    return bool(found.sample_info.instance_state == InstanceState.Alive)


def _name(quality: Any) -> str:
    """Program, process and computer, as Cyclone's participants tell them."""
    told = {each.key: each.value for each in quality if hasattr(each, "key")}
    program, process = told.get("__ProcessName"), told.get("__Pid")
    return f"{program or 'a program'} (process {process or '?'} on {told.get('__Hostname', '?')})"
