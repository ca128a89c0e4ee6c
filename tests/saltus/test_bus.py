"""What the bus promises, in memory and over Zenoh alike."""

import contextlib
import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import zenoh
from bus_ends import PREFIX, RUN, TIMEOUT_S, done, until
from memory_bus import MemoryBus, MemoryHub
from samples import message_of

from saltus.errors import MessageError
from saltus.wire import codec
from saltus.wire.bus import RING, Bell, Bus, Latest, MessageStream, Publisher, RawSample, Sample
from saltus.wire.codec import Envelope
from saltus.wire.joining import open_session
from saltus.wire.messages import DepthFrame, Done
from saltus.wire.zenoh_bus import ZenohBus

KEY = f"{PREFIX}/done/render"


@pytest.fixture(params=["memory", "zenoh"])
def pair(request: pytest.FixtureRequest) -> Iterator[tuple[Bus, Bus]]:
    if request.param == "memory":
        hub = MemoryHub()
        yield MemoryBus(PREFIX, hub), MemoryBus(PREFIX, hub)
    else:
        endpoint = request.getfixturevalue("endpoint")
        with ZenohBus.of_run(endpoint, RUN) as a, ZenohBus.of_run(endpoint, RUN) as b:
            yield a, b


def meet(*publishers: Publisher) -> None:
    """Waits until subscribers are known: what is put before reaches nobody."""
    until(lambda: all(publisher.heard() for publisher in publishers))


def wait(latest: Latest) -> Sample:
    sample = latest.wait(TIMEOUT_S)
    assert sample is not None, "nothing came"
    return sample


def test_what_is_put_is_taken_once(pair: tuple[Bus, Bus]) -> None:
    a, b = pair
    publisher, latest = a.publisher("done", "render"), b.latest("done", "render")
    assert latest.take() is None
    assert latest.silent_s() == float("inf")
    meet(publisher)
    publisher.put(done(1))
    sample = wait(latest)
    assert sample.message.step == 1
    assert sample.envelope.capture_ns == sample.message.time_ns
    assert sample.envelope.boot_id == a.boot_id
    assert latest.silent_s() < TIMEOUT_S
    assert latest.wait(0.02) is None
    assert not b.rejected


def test_the_newest_is_taken_and_nothing_older_after_it(pair: tuple[Bus, Bus]) -> None:
    a, b = pair
    publisher, latest, stream = (
        a.publisher("done", "render"),
        b.latest("done", "render"),
        b.stream(),
    )
    meet(publisher)
    for step in range(1, 201):
        publisher.put(done(step))
    until(lambda: (sample := latest.take()) is not None and sample.message.step == 200)
    assert latest.take() is None
    assert stream.overflowed == 0


def test_who_waits_is_woken_by_what_comes_on_any_key_of_the_bus(pair: tuple[Bus, Bus]) -> None:
    sender, receiver = pair
    states, dones = receiver.latest("controller/state"), receiver.latest("done", "render")
    publisher = sender.publisher("done", "render")
    meet(publisher)
    heard = receiver.bell.rings
    timer = threading.Timer(0.05, publisher.put, (done(1),))
    start_s = time.monotonic()
    timer.start()
    receiver.bell.wait(heard, TIMEOUT_S)
    assert 0.04 < time.monotonic() - start_s < TIMEOUT_S
    assert states.take() is None
    sample = dones.take()
    assert sample is not None
    assert sample.message.step == 1
    assert states.wait(0.05) is None, "another key's message is not an answer"


def test_a_bell_that_rang_in_between_is_not_waited_for() -> None:
    bell = Bell()
    heard = bell.rings
    bell.ring()
    start_s = time.monotonic()
    bell.wait(heard, TIMEOUT_S)
    assert time.monotonic() - start_s < TIMEOUT_S
    bell.wait(bell.rings, 0.02)
    assert time.monotonic() - start_s >= 0.02


def test_a_bell_wakes_everybody() -> None:
    bell, woken = Bell(), []
    waiters = [
        threading.Thread(target=lambda: woken.append(bell.wait(0, TIMEOUT_S))) for _ in range(4)
    ]
    for waiter in waiters:
        waiter.start()
    bell.ring()
    for waiter in waiters:
        waiter.join(0.5 * TIMEOUT_S)
    assert len(woken) == len(waiters)


def test_topics_and_suffixes_are_keys_of_their_own(pair: tuple[Bus, Bus]) -> None:
    a, b = pair
    publisher, other = a.publisher("done", "render"), b.latest("done", "policy")
    latest = b.latest("done", "render")
    meet(publisher)
    publisher.put(done(1))
    wait(latest)
    assert other.take() is None


def test_what_was_sent_before_is_there_first_on_whichever_key(pair: tuple[Bus, Bus]) -> None:
    """A state asks for the heightmap of the image that was sent just before it."""
    a, b = pair
    frames, states = a.publisher("camera/depth"), a.publisher("done", "render")
    frame = replace(message_of(DepthFrame), depth=np.ones((240, 424), np.uint16))
    frames_in, states_in = b.latest("camera/depth"), b.latest("done", "render")
    meet(frames, states)
    for step in range(1, 1001):
        frames.put(replace(frame, frame_id=step))
        states.put(done(step))
        assert wait(states_in).message.step == step
        newest = frames_in.take()
        assert newest is not None
        assert newest.message.frame_id == step


def test_unknown_topics_name_the_nearest(pair: tuple[Bus, Bus]) -> None:
    for make in (pair[0].publisher, pair[0].latest):
        with pytest.raises(MessageError, match="did you mean 'camera/depth'"):
            make("camera/dept")


def test_the_stream_counts_what_nobody_drained(pair: tuple[Bus, Bus]) -> None:
    a, b = pair
    publisher, stream = a.publisher("done", "render"), b.stream(capacity=3)
    meet(publisher)
    for step in range(10):
        publisher.put(done(step))
    until(lambda: stream.overflowed == 7)
    assert [sample.key for sample in stream.drain()] == ["done/render"] * 3


def test_what_zenoh_keeps_is_dated_when_it_came(endpoint: str) -> None:
    """Not when it was drained, and not when a clock says that is set:
    never outside of two drains.
    """
    kept = replace(RUN, prefix="kept")
    with (
        ZenohBus.of_run(endpoint, kept) as a,
        ZenohBus.of_run(endpoint, kept, dates=True) as b,
    ):
        publisher, stream = a.publisher("done", "render"), b.stream()
        meet(publisher)
        plain = a.stream()  # at once: its session's own; before, it would be who is met
        assert stream.drain() == []
        put_ns = []
        for step in range(30):
            put_ns.append(time.monotonic_ns())
            publisher.put(done(step))
            time.sleep(0.005)
        heard, seen = [], []

        def all_came(stream: MessageStream, samples: list[RawSample]) -> bool:
            samples.extend(stream.drain())
            return len(samples) == 30

        until(lambda: all_came(plain, seen))
        until(lambda: all_came(stream, heard))
        assert [(s.key, s.payload, s.attachment) for s in heard] == [
            (s.key, s.payload, s.attachment) for s in seen
        ]
        came_ns = [s.arrival_ns for s in heard]
        assert came_ns == sorted(came_ns)
        assert len(set(came_ns)) > 15, "they came one by one, and were drained together"
        rounding_ns = 1_000_000  # of two clocks that are read one after the other
        assert all(c >= p - rounding_ns for c, p in zip(came_ns, put_ns, strict=True))
        assert came_ns[-1] <= time.monotonic_ns()
        publisher.put(done(30))
        until(lambda: any(codec.decode_message(Done, s.payload).step == 30 for s in plain.drain()))
        stream.end()
        assert len(stream.drain()) <= 1
        assert stream.drain() == []


def test_what_nobody_waits_for_wakes_nobody(pair: tuple[Bus, Bus]) -> None:
    a, b = pair
    publisher = a.publisher("done", "render")
    latest = b.latest("done", "render", rings=False)
    meet(publisher)
    heard = b.bell.rings
    for step in range(1, 10 * RING):
        publisher.put(done(step))
    until(lambda: (sample := latest.take()) is not None and sample.message.step == 10 * RING - 1)
    assert latest.take() is None
    assert b.bell.rings == heard
    assert not b.rejected


def test_payloads_of_any_size_leave_the_link_whole(endpoint: str) -> None:
    huge = replace(RUN, prefix="huge")
    with (
        contextlib.closing(open_session("client", endpoint, RUN.link_speed)) as stranger,
        ZenohBus.of_run(endpoint, huge) as a,
        ZenohBus.of_run(endpoint, huge) as b,
    ):
        publisher, latest = a.publisher("done", "render"), b.latest("done", "render")
        meet(publisher)
        for size_mib in (5, 40):  # beyond what a process takes, and beyond what the transport takes
            # On a busy computer one that may be dropped would be
            block = zenoh.CongestionControl.BLOCK
            stranger.put("huge/done/render", bytes(size_mib * 2**20), congestion_control=block)
            publisher.put(done(2))
            wait(latest)
        until(lambda: latest.take() is None and b.rejected == {"done/size": 1})
        assert a.connected()
        assert b.connected()


class Wire:
    """Bytes on one key of a memory bus."""

    def __init__(self) -> None:
        self.bus = MemoryBus(PREFIX)
        self.latest = self.bus.latest("done", "render")

    def send(
        self,
        step: int,
        envelope: Envelope,
        payload: bytes | None = None,
        attachment: bytes | None = None,
    ) -> None:
        message = done(step)
        capture = (
            replace(envelope, capture_ns=message.time_ns) if envelope.capture_ns == 0 else envelope
        )
        self.bus.hub.inject(
            KEY,
            codec.encode_message(message) if payload is None else payload,
            capture.to_bytes() if attachment is None else attachment,
        )

    def steps(self) -> list[int]:
        sample = self.latest.take()
        return [] if sample is None else [sample.message.step]


OLD, NEW = b"a" * 16, b"b" * 16


def test_duplicates_and_late_messages_are_dropped_and_counted() -> None:
    wire = Wire()
    wire.send(5, Envelope(5, 0, OLD))
    assert wire.steps() == [5]
    for sequence, reason in ((5, "duplicate"), (4, "out_of_order"), (1, "out_of_order")):
        wire.send(sequence, Envelope(sequence, 0, OLD))
        before = wire.bus.rejected[f"done/{reason}"]
        assert wire.steps() == []
        assert wire.bus.rejected[f"done/{reason}"] == before + 1
    wire.send(9, Envelope(9, 0, OLD))
    assert wire.steps() == [9]


def test_a_new_process_takes_over_and_the_old_one_is_heard_no_more() -> None:
    wire = Wire()
    wire.send(500, Envelope(500, 0, OLD))
    assert wire.steps() == [500]
    wire.send(1, Envelope(1, 0, NEW))
    assert wire.steps() == [1]
    wire.send(501, Envelope(501, 0, OLD))
    assert wire.steps() == []
    assert wire.bus.rejected == {"done/old_sender": 1}


def test_malformed_messages_are_counted_and_do_not_hide_a_good_one() -> None:
    wire = Wire()
    wire.send(1, Envelope(1, 0, OLD))
    good = codec.encode_message(done(2))
    wire.send(2, Envelope(2, 0, OLD), payload=b"")
    wire.send(2, Envelope(2, 0, OLD), payload=good[:-1])
    wire.send(2, Envelope(2, 0, OLD), payload=bytes(codec.PAYLOAD_MAX + 1))
    wire.send(2, Envelope(2, 0, OLD), attachment=b"")
    wire.send(2, Envelope(2, 1, OLD))
    assert wire.steps() == [1]
    expected = dict.fromkeys(("empty", "malformed", "size", "envelope", "capture_time"), 1)
    assert wire.bus.rejected == {f"done/{reason}": count for reason, count in expected.items()}


def test_a_slow_consumer_gets_the_newest_not_a_backlog() -> None:
    wire = Wire()
    for step in range(1, 10 * RING):
        wire.send(step, Envelope(step, 0, OLD))
    assert wire.steps() == [10 * RING - 1]
    assert wire.steps() == []
