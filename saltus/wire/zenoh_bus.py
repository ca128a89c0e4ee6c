"""The bus over Zenoh."""

import time
from collections.abc import Callable
from typing import Any

import zenoh

from saltus.config import RunConfig
from saltus.tuning import keep_thread, switch_soon
from saltus.wire import codec
from saltus.wire.bus import RING, STREAM_CAPACITY, Bell, Bus, Latest, MessageStream, RawSample, Slot
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
    With `dates` Zenoh itself dates and keeps what comes for a `stream`: its thread need not enter
    Python hundreds of times a second, which takes a third of what a message costs its receiver.

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
        dates: bool = False,
        bell: Bell | None = None,
    ) -> None:
        super().__init__(prefix, bell or Bell())
        self._dates = dates
        # Waiting would stall a control loop of real time for seconds on one slow subscriber
        self._when_full = zenoh.CongestionControl.BLOCK if waits else zenoh.CongestionControl.DROP
        self._session = open_session("peer" if peer else "client", endpoint, speed, dates=dates)

    @classmethod
    def of_run(
        cls,
        endpoint: str,
        run: RunConfig,
        *,
        peer: bool = False,
        dates: bool = False,
        bell: Bell | None = None,
    ) -> "ZenohBus":
        """The bus of the robot of a run, with links that its pace and speed ask for."""
        return cls(
            endpoint,
            run.prefix,
            peer=peer,
            speed=run.link_speed,
            waits=run.pace == "lockstep",
            dates=dates,
            bell=bell,
        )

    def publisher(self, topic: str, suffix: str = "") -> "ZenohPublisher":
        """See `Bus.publisher`."""
        key = self._key(topic, suffix)
        row = TOPICS[topic]
        codec.prepare(row.message)
        raw = self._session.declare_publisher(
            key,
            encoding=codec.encoding_of(row.message),
            congestion_control=self._when_full,
            priority=zenoh.Priority.REAL_TIME if row.urgent else zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
        )
        return ZenohPublisher(raw, self)

    def latest(self, topic: str, suffix: str = "", *, rings: bool = True) -> Latest:
        """See `Bus.latest`."""
        key = self._key(topic, suffix)
        name = key.removeprefix(f"{self.prefix}/")
        if not rings:
            channel: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(RING)
            kept = KeptSlot(self.bell, self._session.declare_subscriber(key, channel), name)
            return self._latest(topic, kept)
        slot = Slot(self.bell)

        def receive(sample: zenoh.Sample) -> None:
            keep_thread()
            slot.push(_raw(sample, name))

        # Not Zenoh's channels: who looks into them again and again notices 0.3 ms late, and the
        # FIFO lets a slow consumer fall seconds behind and then blocks the session. Not indirect:
        # with a thread for each key, a state overtakes the image that was sent before it.
        self._session.declare_subscriber(key, zenoh.handlers.Callback(receive, indirect=False))
        return self._latest(topic, slot)

    def stream(self, capacity: int = STREAM_CAPACITY) -> MessageStream:
        """See `Bus.stream`."""
        start = len(self.prefix) + 1
        if self._dates:
            channel: zenoh.handlers.FifoChannel[zenoh.Sample] = zenoh.handlers.FifoChannel(capacity)
            return KeptStream(self._session.declare_subscriber(f"{self.prefix}/**", channel), start)
        stream = MessageStream(capacity)
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
        """Gives each batch that a supervisor hands on to `receive`,
        for `saltus.wire.sharing.unpack_samples`.
        """
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


class KeptSlot(Slot):
    """A slot that Zenoh fills by itself, without a word to Python;
    what is taken has come just now.
    """

    def __init__(self, bell: Bell, subscriber: Any, name: str) -> None:
        super().__init__(bell)
        self._subscriber, self._name = subscriber, name

    def pop(self) -> RawSample | None:
        """See `Slot.pop`."""
        sample = self._subscriber.try_recv()
        return None if sample is None else _raw(sample, self._name)


class KeptStream(MessageStream):
    """A stream whose messages Zenoh keeps, dated, until they are drained.

    Where nobody drains it for so long that it is full, nothing more comes: senders in real time
    then lose messages, which readers see by their sequence.
    """

    def __init__(self, subscriber: Any, start: int) -> None:
        super().__init__(0)
        self._kept, self._start = subscriber.handler, start
        self._drained_ns = time.monotonic_ns()
        self.end = subscriber.undeclare

    def drain(self) -> list[RawSample]:
        """See `MessageStream.drain`."""
        now_ns = time.monotonic_ns()
        ahead_ns, since_ns = time.time_ns() - now_ns, self._drained_ns
        samples = []
        while (sample := self._next()) is not None:
            date = sample.timestamp
            came_ns = now_ns if date is None else date.get_time_as_ntp64().as_nanos() - ahead_ns
            # The system's clock may have been set in between
            came_ns = min(max(came_ns, since_ns), max(now_ns, since_ns))
            samples.append(_raw(sample, str(sample.key_expr)[self._start :], came_ns))
        self._drained_ns = now_ns
        return samples

    def _next(self) -> Any:
        try:
            return self._kept.try_recv()
        except zenoh.ZError:  # it has ended
            return None


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
        payload = codec.encode_message(message)
        self._sequence += 1
        envelope = Envelope(self._sequence, message.time_ns, self._bus.boot_id)
        self._publisher.put(payload, attachment=envelope.to_bytes())


def _matches(publisher: zenoh.Publisher) -> bool:
    status: Any = publisher.matching_status  # a bool by its stub alone
    return bool(status.matching)


def _raw(sample: zenoh.Sample, key: str, came_ns: int | None = None) -> RawSample:
    """Copies a sample out of Zenoh; what is beyond the limit is not worth a copy of its own.

    It came now where nobody knows better.
    """
    payload, attachment = sample.payload, sample.attachment
    data = payload.to_bytes() if len(payload) <= codec.PAYLOAD_MAX else bytes(codec.PAYLOAD_MAX + 1)
    beside = b"" if attachment is None else attachment.to_bytes()
    return RawSample(key, data, beside, time.monotonic_ns() if came_ns is None else came_ns)
