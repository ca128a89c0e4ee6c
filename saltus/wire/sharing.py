"""A run's messages for who only looks on: many at a time, from the supervisor, which has them all.

Each message that goes to one more process wakes it just when those of the robot have to run,
hundreds of times a second. In batches the same messages come 80 ms later at most, 40 ms of them
until the supervisor reads what has come, and wake it 25 times a second.
"""

import itertools
import struct
import time
from collections.abc import Callable, Iterable, Iterator

from saltus.wire import codec
from saltus.wire.bus import RawSample

PERIOD_S = 0.04  # of the machine: as often as films change their picture
HEAD = struct.Struct("<qIII")
"""Before each sample: how long ago it came in [ns], as clocks of machines differ, and the bytes of
key, attachment and payload, which follow."""


class Sharer:
    """Hands on what came in while somebody looks on.

    Args:
        put: Sends a batch.
        looked_on: Whether anybody is there to receive it.
    """

    def __init__(self, put: Callable[[bytes], None], looked_on: Callable[[], bool]) -> None:
        self._put, self._looked_on = put, looked_on
        self._samples: list[RawSample] = []
        self._wanted = False
        self._sent_s = float("-inf")

    def take(self, samples: Iterable[RawSample]) -> None:
        """Adds these, and sends what is there, if it is due."""
        if self._wanted:
            self._samples += samples
        if time.monotonic() - self._sent_s < PERIOD_S:
            return
        self._sent_s = time.monotonic()
        if self._wanted:
            for batch in _bounded(self._samples):
                self._put(packed(batch))
        self._samples = []
        self._wanted = self._looked_on()


def packed(samples: Iterable[RawSample]) -> bytes:
    """One batch of these samples."""
    now_ns, parts = time.monotonic_ns(), list[bytes]()
    for raw in samples:
        key = raw.key.encode()
        head = HEAD.pack(now_ns - raw.arrival_ns, len(key), len(raw.attachment), len(raw.payload))
        parts += [head, key, raw.attachment, raw.payload]
    return b"".join(parts)


def unpack_samples(batch: bytes) -> list[RawSample]:
    """Samples of a batch, up to where it is malformed."""
    now_ns, place, samples = time.monotonic_ns(), 0, list[RawSample]()
    while place + HEAD.size <= len(batch):
        age_ns, *sizes = HEAD.unpack_from(batch, place)
        ends = list(itertools.accumulate(sizes, initial=place + HEAD.size))
        key, attachment, payload = (batch[start:end] for start, end in itertools.pairwise(ends))
        place = ends[-1]
        if place > len(batch):
            break
        samples.append(
            RawSample(key.decode(errors="replace"), payload, attachment, now_ns - age_ns)
        )
    return samples


def _bounded(samples: list[RawSample]) -> Iterator[list[RawSample]]:
    """Batches that a process does not refuse for their size.

    One is there even where there are no samples.
    """
    batch: list[RawSample] = []
    size = 0
    for sample in samples:
        own = len(sample.key) + len(sample.attachment) + len(sample.payload)
        if batch and size + own > codec.PAYLOAD_MAX:
            yield batch
            batch, size = [], 0
        batch.append(sample)
        size += own
    yield batch
