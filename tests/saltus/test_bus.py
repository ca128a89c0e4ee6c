"""What the bus promises, in memory and over Zenoh alike."""

import contextlib
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest
import zenoh
from memory_bus import MemoryBus, MemoryHub
from samples import message_of

from saltus.config import RunConfig
from saltus.errors import MessageError, StackError
from saltus.resources import resource
from saltus.wire import codec
from saltus.wire.bus import RING, Bell, Bus, Latest, Publisher, RawSample, Sample, Stream
from saltus.wire.codec import Envelope
from saltus.wire.joining import LOCAL, open_session, write_client
from saltus.wire.messages import DepthFrame, Done, Event
from saltus.wire.router import open_router
from saltus.wire.zenoh_bus import ZenohBus

# Nothing is lost on its links, however busy the computer: senders wait
RUN = RunConfig(robot="go1", grid="line", pace="lockstep")
PREFIX = RUN.prefix
KEY = f"{PREFIX}/done/render"
TIMEOUT_S = 10.0


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    endpoint, router = open_router(speed=RUN.link_speed)
    yield endpoint
    router.close()


@pytest.fixture(params=["memory", "zenoh"])
def pair(request: pytest.FixtureRequest) -> Iterator[tuple[Bus, Bus]]:
    if request.param == "memory":
        hub = MemoryHub()
        yield MemoryBus(PREFIX, hub), MemoryBus(PREFIX, hub)
    else:
        endpoint = request.getfixturevalue("endpoint")
        with ZenohBus.of_run(endpoint, RUN) as a, ZenohBus.of_run(endpoint, RUN) as b:
            yield a, b


def done(step: int) -> Done:
    return Done(time_ns=10_000_000 * step, step=step, process="render", frame_id=step)


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < deadline, "nothing came"
        time.sleep(0.001)


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
    """Not when it was drained, and not when a clock says that is set: never outside of two drains."""
    kept = replace(RUN, prefix="kept")
    with (
        ZenohBus.of_run(endpoint, kept) as a,
        ZenohBus.of_run(endpoint, kept, dates=True) as b,
    ):
        publisher, stream, plain = a.publisher("done", "render"), b.stream(), a.stream()
        meet(publisher)
        assert stream.drain() == []
        put_ns = []
        for step in range(30):
            put_ns.append(time.monotonic_ns())
            publisher.put(done(step))
            time.sleep(0.005)
        heard, seen = [], []

        def all_came(stream: Stream, samples: list[RawSample]) -> bool:
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
        until(lambda: any(codec.decode(Done, s.payload).step == 30 for s in plain.drain()))
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
            codec.encode(message) if payload is None else payload,
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
    good = codec.encode(done(2))
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


COUNT = """import sys, time
from saltus.wire.zenoh_bus import ZenohBus
with ZenohBus(sys.argv[1], sys.argv[2], speed=float(sys.argv[4])) as bus:
    stream, events = bus.stream(), 0
    until_s = time.monotonic() + float(sys.argv[3])
    while not stream.drain() and time.monotonic() < until_s:
        time.sleep(0.01)
    print("heard", flush=True)
    while events < 10 and time.monotonic() < until_s:
        events += sum(sample.key.startswith("event/") for sample in stream.drain())
        time.sleep(0.01)
    print(events)
"""


def test_events_reach_who_stood_still_while_images_were_lost() -> None:
    """A page of low priority on a busy computer; and what an operator asks is an event."""
    speed = 0.05  # links last for 10 s of the machine
    endpoint, router = open_router(speed=speed)
    image = replace(message_of(DepthFrame), depth=np.zeros((240, 80), np.uint16))
    event = message_of(Event)
    command = [sys.executable, "-c", COUNT, endpoint, "flood", str(TIMEOUT_S), str(speed)]
    with (
        contextlib.closing(router),
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as counting,
        ZenohBus(endpoint, "flood", speed=speed) as bus,
    ):
        assert counting.stdout is not None
        images, events = bus.publisher("camera/depth"), bus.publisher("event", "render")
        while not select.select([counting.stdout], [], [], 0.01)[0]:
            images.put(image)
        assert counting.stdout.readline() == "heard\n"
        counting.send_signal(signal.SIGSTOP)
        for number in range(100):
            images.put(image)
            if number % 10 == 9:
                events.put(event)
        counting.send_signal(signal.SIGCONT)
        assert counting.stdout.readline() == "10\n"


def test_links_of_a_slowed_run_last_as_long_in_its_clock(tmp_path: Path) -> None:
    """Who stands still for 1.2 s of the machine, 0.12 s of a run at a tenth of its speed, misses nothing."""
    speed, event = 0.1, message_of(Event)
    endpoint, router = open_router(speed=speed)
    write_client(tmp_path / "client.json5", endpoint, speed=speed)
    with contextlib.closing(router), ZenohBus(endpoint, "slow", peer=True, speed=speed) as bus:
        for joins in (endpoint, str(tmp_path / "client.json5")):
            command = [sys.executable, "-c", COUNT, joins, "slow", str(TIMEOUT_S), str(speed)]
            with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as counting:
                assert counting.stdout is not None
                events, waiting = bus.publisher("event", "render"), bus.publisher("done", "render")
                while not select.select([counting.stdout], [], [], 0.01)[0]:
                    waiting.put(done(1))
                assert counting.stdout.readline() == "heard\n"
                counting.send_signal(signal.SIGSTOP)
                for _ in range(10):
                    time.sleep(0.12)
                    events.put(event)
                counting.send_signal(signal.SIGCONT)
                assert counting.stdout.readline() == "10\n"


@pytest.mark.parametrize("name", ["router", "peer", "client"])
def test_configurations_are_closed(name: str) -> None:
    """Zenoh refuses unknown keys when it loads a file."""
    settings = zenoh.Config.from_file(str(resource(f"zenoh_cfg/{name}.json5")))
    assert settings.get_json("scouting/multicast/enabled") == "false"
    assert settings.get_json("scouting/gossip/enabled") == (
        "true" if name in ("router", "peer") else "false"
    )
    if name != "client":  # which never listens
        assert settings.get_json("listen/endpoints") == "[]"
    assert settings.get_json("transport/shared_memory/enabled") == "false"
    assert settings.get_json("transport/link/tx/lease") == "500"
    assert settings.get_json("adminspace/enabled") == "false"


def test_peers_and_clients_hear_everything_once(endpoint: str) -> None:
    """Two processes of a stack and two from elsewhere: whatever way a message takes."""
    mesh = replace(RUN, prefix="mesh")
    with contextlib.ExitStack() as stack:
        buses = [
            stack.enter_context(ZenohBus.of_run(endpoint, mesh, peer=peer))
            for peer in (True, True, False, False)
        ]
        publishers = [bus.publisher("done", str(i)) for i, bus in enumerate(buses)]
        streams = [bus.stream() for bus in buses]
        heard: list[list[tuple[str, int]]] = [[] for _ in streams]

        def send(step: int) -> None:
            for publisher in publishers:
                publisher.put(done(step))

        def heard_after(step: int) -> bool:
            send(step)
            return all_heard(step)

        def all_heard(step: int) -> bool:
            for stream, samples in zip(streams, heard, strict=True):
                samples.extend(
                    (raw.key, codec.decode(Done, raw.payload).step) for raw in stream.drain()
                )
            return all(
                (f"done/{i}", step) in samples for samples in heard for i in range(len(buses))
            )

        until(lambda: heard_after(0))  # until all links are there
        for step in range(1, 51):
            send(step)
        until(lambda: all_heard(50))
    for samples in heard:
        for i in range(len(buses)):
            assert [step for key, step in samples if key == f"done/{i}" and step > 0] == [
                *range(1, 51)
            ]


def test_a_bus_without_router_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    endpoint, router = open_router()
    router.close()
    started = time.monotonic()
    with pytest.raises(StackError, match="no Zenoh router at unixsock-stream/"):
        ZenohBus(endpoint, PREFIX)
    assert time.monotonic() - started < TIMEOUT_S


def test_only_their_owner_reaches_router_and_peers() -> None:
    """All that listens is a socket in a folder that others may not enter, and that is gone with the router."""
    before = listening()
    endpoint, router = open_router()
    folder = Path(endpoint.removeprefix(LOCAL)).parent
    with (
        contextlib.closing(router),
        ZenohBus(endpoint, PREFIX, peer=True),
        ZenohBus(endpoint, PREFIX, peer=True),
    ):
        sockets = listening() - before
        assert len(sockets) == 3
        assert {Path(place).parent for place in sockets} == {folder}
        assert folder.stat().st_mode & 0o777 == 0o700
    assert not folder.exists()


def listening() -> set[str]:
    """Ports, and paths of sockets, of this process."""
    found = psutil.Process().net_connections("all")
    return {
        str(one.laddr)
        for one in found
        if one.status == psutil.CONN_LISTEN or (one.laddr and not one.raddr)
    }


def test_peers_link_only_beside_a_router_of_their_owner() -> None:
    with pytest.raises(StackError, match="folder of their owner"):
        ZenohBus("tcp/127.0.0.1:7447", PREFIX, peer=True)


@pytest.mark.parametrize("endpoint", ["foo", "", "tcp/127.0.0.1:7447;", 'tcp/127.0.0.1:7447"'])
def test_what_is_no_endpoint_is_said_to_be_none(endpoint: str) -> None:
    with pytest.raises(StackError, match=r"no endpoint|no Zenoh router"):
        ZenohBus(endpoint, PREFIX)
