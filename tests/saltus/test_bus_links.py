"""Links of a run's bus: of peers and clients, of a slowed run, to their owner alone."""

import contextlib
import select
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest
import zenoh
from bus_ends import PREFIX, RUN, TIMEOUT_S, done, until
from samples import message_of

from saltus.errors import StackError
from saltus.resources import shipped_file
from saltus.wire import codec
from saltus.wire.joining import LOCAL, write_client
from saltus.wire.messages import DepthFrame, Done, Event
from saltus.wire.router import open_router
from saltus.wire.zenoh_bus import ZenohBus

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
    """A process that stands still for 0.12 s of a run at a tenth of its speed misses nothing."""
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
    settings = zenoh.Config.from_file(str(shipped_file(f"zenoh_cfg/{name}.json5")))
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
                    (raw.key, codec.decode_message(Done, raw.payload).step)
                    for raw in stream.drain()
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
    """All that listens is a socket in a folder that others may not enter,
    and that is gone with the router.
    """
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
