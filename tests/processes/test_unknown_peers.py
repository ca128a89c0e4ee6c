"""Strangers who reach the port of a router that listens on a network, and have no certificate."""

import socket
import subprocess
import sys
import time
from pathlib import Path

import psutil
import zenoh
from limits import file_numbers_below

from saltus.wire.certificates import create_authority, network_of
from saltus.wire.router import open_router

FILES, STRANGERS = 256, 400
CONNECT = """
import resource, socket, sys
most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))  # strangers have limits of their own
connections = [socket.create_connection((sys.argv[1], int(sys.argv[2])), timeout=5.0) for _ in range(int(sys.argv[3]))]
print("there", flush=True)
sys.stdin.read()
"""


def test_who_connects_says_nothing_and_stays_takes_no_files_that_a_run_needs(
    tmp_path: Path,
) -> None:
    """More of them than a process may usually open files:
    each holds one of the router's process, the supervisor.
    """
    with socket.create_server(("127.0.0.1", 0)) as server:
        host, port = server.getsockname()
    create_authority(tmp_path / "keys", f"{host}:{port}", days=1)
    with file_numbers_below(FILES):
        endpoint, router = open_router(network_of(tmp_path / "keys", f"{host}:{port}", "saltus"))
        arguments = [sys.executable, "-c", CONNECT, host, str(port), str(STRANGERS)]
        with (
            router,
            subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as strangers,
        ):
            assert strangers.stdout is not None
            assert strangers.stdout.readline() == b"there\n"
            while psutil.Process().num_fds() < STRANGERS:  # which opens a file itself
                time.sleep(0.01)
            assert heard(endpoint) == [b"states"]
            strangers.communicate()


def heard(endpoint: str) -> list[bytes]:
    """What one client of a router receives that another sends."""
    config = zenoh.Config.from_json5(
        f'{{mode: "client", connect: {{endpoints: ["{endpoint}"], timeout_ms: 5000}}}}'
    )
    with zenoh.open(config) as sender, zenoh.open(config) as receiver:
        told = receiver.declare_subscriber("saltus/key", zenoh.handlers.FifoChannel(4))
        publisher = sender.declare_publisher("saltus/key")
        while not publisher.matching_status.matching:
            time.sleep(0.001)
        publisher.put(b"states")
        return [told.recv().payload.to_bytes()]
