"""A bus inside one process: the same codec, checks and counters as over Zenoh."""

import time

from saltus.wire import codec
from saltus.wire.bus import STREAM_CAPACITY, Bell, Bus, Latest, MessageStream, RawSample, Slot
from saltus.wire.codec import Envelope
from saltus.wire.messages import Message


class MemoryHub:
    """The exchange that the memory buses of several processes share."""

    def __init__(self) -> None:
        self.bell = Bell()
        """Bell of all buses of the hub."""
        self._slots: dict[str, list[Slot]] = {}
        self._streams: list[tuple[str, MessageStream]] = []

    def attach(self, key: str, slot: Slot) -> None:
        """Subscribes a slot to one key."""
        self._slots.setdefault(key, []).append(slot)

    def attach_stream(self, prefix: str, stream: MessageStream) -> None:
        """Subscribes a stream to all keys below a prefix."""
        self._streams.append((f"{prefix}/", stream))

    def inject(self, key: str, payload: bytes, attachment: bytes) -> None:
        """Delivers bytes as they are, malformed ones too."""
        now_ns = time.monotonic_ns()
        for prefix, stream in self._streams:  # first, so that they have causes before effects
            if key.startswith(prefix):
                stream.push(RawSample(key.removeprefix(prefix), payload, attachment, now_ns))
        for slot in self._slots.get(key, ()):
            slot.push(RawSample(key, payload, attachment, now_ns))


class MemoryBus(Bus):
    """A bus over a `MemoryHub`; a hub of its own where none is given."""

    def __init__(self, prefix: str, hub: MemoryHub | None = None) -> None:
        self.hub = hub or MemoryHub()
        super().__init__(prefix, self.hub.bell)

    def publisher(self, topic: str, suffix: str = "") -> "MemoryPublisher":
        """See `Bus.publisher`."""
        return MemoryPublisher(self, self._key(topic, suffix))

    def latest(self, topic: str, suffix: str = "", *, rings: bool = True) -> Latest:
        """See `Bus.latest`."""
        slot = Slot(self.bell if rings else Bell())
        self.hub.attach(self._key(topic, suffix), slot)
        return self._latest(topic, slot)

    def stream(self, capacity: int = STREAM_CAPACITY) -> MessageStream:
        """See `Bus.stream`."""
        stream = MessageStream(capacity)
        self.hub.attach_stream(self.prefix, stream)
        return stream

    def connected(self) -> bool:
        """Always."""
        return True

    def close(self) -> None:
        """Nothing to leave."""


class MemoryPublisher:
    """Encodes and delivers the messages of one key."""

    def __init__(self, bus: MemoryBus, key: str) -> None:
        self._bus = bus
        self._key = key
        self._sequence = 0

    def heard(self) -> bool:
        """Always."""
        return True

    def put(self, message: Message) -> None:
        """Encodes and delivers, unless its bus is muted.

        Raises as `saltus.wire.codec.encode_message` does.
        """
        if self._bus.muted:
            return
        payload = codec.encode_message(message)
        self._sequence += 1
        envelope = Envelope(self._sequence, message.time_ns, self._bus.boot_id)
        self._bus.hub.inject(self._key, payload, envelope.to_bytes())
