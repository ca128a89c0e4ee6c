"""Robots in processes of their own: simulated ones, and a peer in C with the DDS that Unitree ships."""

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).parent
LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo'/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<Peers><Peer address='localhost'/></Peers></Discovery></Domain></CycloneDDS>"
)


def own_domain() -> int:
    """A domain by the number of this process, so that tests beside it are in others: 2 to 231."""
    return 2 + os.getpid() % 230


@contextlib.contextmanager
def saltus(*command: str) -> Iterator["subprocess.Popen[str]"]:
    with subprocess.Popen(
        [sys.executable, "-P", "-m", "saltus.cli.main", *command], stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            yield process
        finally:
            process.terminate()


@contextlib.contextmanager
def simulated(domain: int, *more: str) -> Iterator["subprocess.Popen[str]"]:
    """A simulated robot that has begun."""
    with saltus("robot", "simulate", "--domain", str(domain), *more) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("simulated go2")
        yield process


def compiled_peer(folder: Path) -> Path:
    """The peer in C, with types that Debian's idlc 0.10.2 makes."""
    subprocess.run(["/usr/bin/idlc", str(HERE / "unitree_go.idl")], cwd=folder, check=True)
    sources = [str(HERE / "unitree_peer.c"), "unitree_go.c"]
    subprocess.run(
        ["/usr/bin/gcc", "-O1", "-I.", "-o", "peer", *sources, "-lddsc"], cwd=folder, check=True
    )
    return folder / "peer"
