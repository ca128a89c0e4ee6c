"""A node of a ROS 2 graph that speaks over Zenoh (rmw_zenoh), without ROS:
keys, liveliness tokens, attachments.

Formats: rmw_zenoh's design document, of Jazzy and later. Payloads and type hashes are for the
    caller to make. Nothing
here knows a secret: whoever reaches the router of that graph reads and writes all of it.
"""

import secrets
import time
from typing import Protocol

import zenoh

from saltus.wire.bus import RawSample, Slot
from saltus.wire.codec import PAYLOAD_MAX, Envelope
from saltus.wire.joining import open_session

TOKENS = "@ros2_lv"
NODE, PUBLISHER, SUBSCRIPTION = "NN", "MP", "MS"
ROOT = "%"  # an empty enclave or namespace
NODE_ID = 0  # one node to a session
RELIABLE = "::,10:,:,:,,"
"""Quality of service in a token: the default, reliable, the last ten.

Subscriptions of every kind match it.
"""
SENSOR = "2::,5:,:,:,,"
"""Quality of service in a token: best effort, the last five."""


def dds_name(type_name: str) -> str:
    """The name that DDS gives a type: sensor_msgs::msg::dds_::Image_ for sensor_msgs/msg/Image."""
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def topic_key(domain: int, topic: str, type_name: str, type_hash: str) -> str:
    """The key under which messages of a topic travel."""
    return f"{domain}/{topic.strip('/')}/{dds_name(type_name)}/{type_hash}"


def node_token(domain: int, session: str, node: str) -> str:
    """The token by which others learn of a node."""
    return f"{TOKENS}/{domain}/{session}/{NODE_ID}/{NODE_ID}/{NODE}/{ROOT}/{ROOT}/{node}"


def endpoint_token(
    domain: int, session: str, entity: int, kind: str, node: str, *,
    topic: str, type_name: str, type_hash: str, quality: str,
) -> str:  # fmt: skip
    """The token by which others learn of a publisher or a subscription of the node."""
    place = f"{TOKENS}/{domain}/{session}/{NODE_ID}/{entity}/{kind}/{ROOT}/{ROOT}/{node}"
    return (
        f"{place}/%{topic.strip('/').replace('/', '%')}/{dds_name(type_name)}/{type_hash}/{quality}"
    )


class RosPublisher(Protocol):
    """One topic of a node."""

    def put(self, payload: bytes, wall_ns: int) -> None:
        """Sends CDR with its header of four bytes, as of a time since 1970 [ns].

        Never waits for a reader.
        """


class RosNode(Protocol):
    """A node of a ROS 2 graph, whatever carries it."""

    def connected(self) -> bool:
        """True where others can be reached."""

    def publisher(self, topic: str, type_name: str, type_hash: str) -> RosPublisher:
        """Announces a publisher; `type_hash` is RIHS01_ and 64 hexadecimal digits."""

    def subscribe(self, topic: str, type_name: str, type_hash: str, slot: Slot) -> None:
        """Announces a subscription and puts what comes into a slot."""


class Ros2Node:
    """A node over Zenoh, as a context manager.

    It is a client: a ROS router passes nothing on between peers.

    Raises:
        StackError: no router answers at the endpoint.
    """

    def __init__(self, endpoint: str, name: str, domain: int) -> None:
        self.name = name
        self._domain = domain
        self._session = open_session("client", endpoint)
        self._id = str(self._session.info.zid())
        self._entities = NODE_ID
        self._kept: list[object] = [
            self._session.liveliness().declare_token(node_token(domain, self._id, name))
        ]

    def __enter__(self) -> "Ros2Node":
        return self

    def __exit__(self, *_: object) -> None:
        self._session.close()

    def connected(self) -> bool:
        """True where the router answers."""
        return bool(self._session.info.routers_zid())

    def publisher(self, topic: str, type_name: str, type_hash: str) -> "Ros2Publisher":
        """Announces a publisher; `type_hash` is RIHS01_ and 64 hexadecimal digits."""
        self._announce(PUBLISHER, topic, type_name, type_hash, RELIABLE)
        raw = self._session.declare_publisher(
            topic_key(self._domain, topic, type_name, type_hash),
            encoding="application/cdr",
            # A slow subscriber must not hold up the others
            congestion_control=zenoh.CongestionControl.DROP,
        )
        return Ros2Publisher(raw)

    def subscribe(self, topic: str, type_name: str, type_hash: str, slot: Slot) -> None:
        """Announces a subscription and puts what comes into a slot,
        whatever its hash: Humble names none.
        """
        self._announce(SUBSCRIPTION, topic, type_name, type_hash, SENSOR)

        def receive(sample: zenoh.Sample) -> None:
            payload = sample.payload
            data = payload.to_bytes() if len(payload) <= PAYLOAD_MAX else b""
            slot.push(RawSample(topic, data, b"", time.monotonic_ns()))

        self._kept.append(
            self._session.declare_subscriber(
                topic_key(self._domain, topic, type_name, "*"), receive
            )
        )

    def _announce(
        self, kind: str, topic: str, type_name: str, type_hash: str, quality: str
    ) -> None:
        self._entities += 1
        token = endpoint_token(
            self._domain, self._id, self._entities, kind, self.name,
            topic=topic, type_name=type_name, type_hash=type_hash, quality=quality,
        )  # fmt: skip
        self._kept.append(self._session.liveliness().declare_token(token))


class Ros2Publisher:
    """Counts and sends the messages of one topic."""

    def __init__(self, raw: zenoh.Publisher) -> None:
        self._raw = raw
        self._identity = secrets.token_bytes(16)
        self._sequence = 0

    def put(self, payload: bytes, wall_ns: int) -> None:
        """Sends CDR; without an attachment of this form a ROS process may abort.

        Args:
            payload: With the header of four bytes.
            wall_ns: When it was sent, since 1970 [ns].
        """
        self._sequence += 1
        self._raw.put(
            payload, attachment=Envelope(self._sequence, wall_ns, self._identity).to_bytes()
        )
