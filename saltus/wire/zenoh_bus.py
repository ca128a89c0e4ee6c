"""The bus over Zenoh."""

import time
from collections.abc import Callable
from typing import Any

import zenoh

from saltus.config import RunConfig
from saltus.tuning import keep_thread, switch_soon
from saltus.wire import codec
from saltus.wire.bus import STREAM_CAPACITY, Bell, Bus, Latest, RawSample, Slot, Stream
from saltus.wire.codec import Envelope
from saltus.wire.joining import open_session
from saltus.wire.messages import Message
from saltus.wire.sharing import Sharer
from saltus.wire.topics import SHARED, TOPICS


class ZenohBus(Bus):
    """A bus over one Zenoh router.

    Clients reach everybody through the router. Peers, which must all be on one machine, learn of
    each other from it: messages between them take one hop instead of two. Links between them are
    there some milliseconds after a peer has opened; what is sent before may be lost. `peer` is for
    processes of the router's own stack, and never to be guessed from the endpoint: what is between
    two peers no router carries. `endpoint` and `speed` are as in `open_session`. What does not fit
    into a full link is lost, unless its sender `waits`: for runs in lockstep, where nobody is late.

    Raises:
        StackError: no router answers at the endpoint, or peers cannot link beside it.
    """

    def __init__(
        self,
        endpoint: str,
        prefix: str,
        *,
        peer: bool = False,
        speed: float = 1.0,
        waits: bool = False,
        bell: Bell | None = None,
    ) -> None:
        super().__init__(prefix, bell or Bell())
        # Waiting would stall a control loop of real time for seconds on one slow subscriber
        self._when_full = zenoh.CongestionControl.BLOCK if waits else zenoh.CongestionControl.DROP
        self._session = open_session("peer" if peer else "client", endpoint, speed)

    @classmethod
    def of_run(
        cls, endpoint: str, run: RunConfig, *, peer: bool = False, bell: Bell | None = None
    ) -> "ZenohBus":
        """The bus of the robot of a run, with links that its pace and speed ask for."""
        waits = run.pace == "lockstep"
        return cls(endpoint, run.prefix, peer=peer, speed=run.link_speed, waits=waits, bell=bell)

    def publisher(self, topic: str, suffix: str = "") -> "ZenohPublisher":
        """See `Bus.publisher`."""
        row = TOPICS.get(topic)
        raw = self._session.declare_publisher(
            self._key(topic, suffix),
            encoding=codec.encoding_of(row.message) if row else None,
            congestion_control=self._when_full,
            priority=zenoh.Priority.REAL_TIME
            if row and row.urgent
            else zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
        )
        return ZenohPublisher(raw, self)

    def latest(self, topic: str, suffix: str = "") -> Latest:
        """See `Bus.latest`."""
        key, slot = self._key(topic, suffix), Slot(self.bell)
        name = key.removeprefix(f"{self.prefix}/")

        def receive(sample: zenoh.Sample) -> None:
            keep_thread()
            slot.push(_raw(sample, name))

        # Not Zenoh's channels: who looks into them again and again notices 0.3 ms late, and the
        # FIFO lets a slow consumer fall seconds behind and then blocks the session. Not indirect:
        # with a thread for each key, a state overtakes the image that was sent before it.
        self._session.declare_subscriber(key, zenoh.handlers.Callback(receive, indirect=False))
        return self._latest(topic, slot)

    def stream(self, capacity: int = STREAM_CAPACITY) -> Stream:
        """See `Bus.stream`."""
        stream = Stream(capacity)
        start = len(self.prefix) + 1
        switch_as_before = switch_soon()

        def receive(sample: zenoh.Sample) -> None:
            stream.push(_raw(sample, str(sample.key_expr)[start:]))

        subscriber = self._session.declare_subscriber(f"{self.prefix}/**", receive)

        def end() -> None:
            subscriber.undeclare()
            switch_as_before()

        stream.end = end
        return stream

    def sharer(self) -> Sharer:
        """Hands on to onlookers, who need not be in time, what it is given."""
        publisher = self._session.declare_publisher(
            f"{self.prefix}/{SHARED}",
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.DATA_LOW,
        )
        return Sharer(publisher.put, lambda: _matches(publisher))

    def look_on(self, receive: Callable[[bytes], None]) -> None:
        """Gives each batch that a supervisor hands on to `receive`, for `saltus.wire.sharing.unpacked`."""
        self._session.declare_subscriber(
            f"{self.prefix}/{SHARED}", lambda it: receive(it.payload.to_bytes())
        )

    def connected(self) -> bool:
        """True where the router answers."""
        return bool(self._session.info.routers_zid())

    def close(self) -> None:
        """Closes the session."""
        if not self._session.is_closed():
            self._session.close()


class ZenohPublisher:
    """Counts and sends the messages of one key."""

    def __init__(self, publisher: zenoh.Publisher, bus: ZenohBus) -> None:
        self._publisher = publisher
        self._bus = bus
        self._sequence = 0

    def heard(self) -> bool:
        """True where a subscriber is known; a link alone is there before its subscribers are."""
        return _matches(self._publisher)

    def put(self, message: Message) -> None:
        """Encodes and sends, unless its bus is muted.

        Never waits, unless the link is full and its bus `waits`.

        Raises:
            MessageError: the message does not have the shape that travels.
        """
        if self._bus.muted:
            return
        payload = codec.encode(message)
        self._sequence += 1
        envelope = Envelope(self._sequence, message.time_ns, self._bus.boot_id)
        self._publisher.put(payload, attachment=envelope.to_bytes())


def _matches(publisher: zenoh.Publisher) -> bool:
    status: Any = publisher.matching_status  # a bool by its stub alone
    return bool(status.matching)


def _raw(sample: zenoh.Sample, key: str) -> RawSample:
    """Copies a sample out of Zenoh; what is beyond the limit is not worth a copy of its own."""
    payload, attachment = sample.payload, sample.attachment
    data = payload.to_bytes() if len(payload) <= codec.PAYLOAD_MAX else bytes(codec.PAYLOAD_MAX + 1)
    return RawSample(
        key, data, b"" if attachment is None else attachment.to_bytes(), time.monotonic_ns()
    )
