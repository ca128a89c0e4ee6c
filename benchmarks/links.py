"""How much does it cost that nobody uninvited joins? One hop through a router,
client to client, by each kind of link.

TCP on loopback without any protection is the reference; sockets in a folder of the owner's are what
a run has; TLS with certificates and the access list is what others have over a network. In turns,
with images and plans at 100 Hz, sender, router and receiver in processes of their own.

    saltus bench links
"""

import json
import socket
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from benchmarks._command import Command, progress
from benchmarks.transport import PREFIX, SPAWN, latencies_ms
from saltus.resources import shipped_file
from saltus.wire.certificates import create_authority, issue_certificate, network_of
from saltus.wire.joining import write_client
from saltus.wire.router import open_router

KINDS = ("TCP", "sockets", "TLS")
TOPICS = {"camera/depth": ("render", "heightmap"), "policy/plan": ("policy", "controller")}
"""Topics, with who sends and who receives them."""


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    messages: int = 300
    """Messages of each topic in each turn."""
    turns: int = 5
    """How often each kind of link has its turn."""

    def measure(self) -> dict[str, Any]:
        times: dict[tuple[str, str], list[float]] = {}
        for _ in progress(range(self.turns), "turns"):
            for kind in KINDS:
                with router(kind) as places:
                    for topic, roles in TOPICS.items():
                        sender, receiver = (str(places[role]) for role in roles)
                        some = latencies_ms(sender, receiver, topic, self.messages, peer=False)
                        times.setdefault((topic, kind), []).extend(some)
        return {
            topic: {
                kind: {
                    "p50_ms": float(np.percentile(times[topic, kind], 50)),
                    "p99_ms": float(np.percentile(times[topic, kind], 99)),
                    "p50_more_%": 100.0
                    * float(np.median(times[topic, kind]) / np.median(times[topic, "TCP"]) - 1.0),
                    "arrived": len(times[topic, kind]),
                }
                for kind in KINDS
            }
            for topic in TOPICS
        }


@contextmanager
def router(kind: str) -> Iterator[dict[str, Path]]:
    """Files with which each role joins a router of another process."""
    with tempfile.TemporaryDirectory() as name, socket.create_server(("127.0.0.1", 0)) as probe:
        folder, address = Path(name), f"127.0.0.1:{probe.getsockname()[1]}"
        probe.close()
        roles = [role for pair in TOPICS.values() for role in pair]
        places = {role: folder / f"{role}.json5" for role in roles}
        if kind == "TLS":
            create_authority(folder / "keys", address, days=1)
            places = {role: issue_certificate(folder / "keys", role, days=1) for role in roles}
        ready, over = SPAWN.Event(), SPAWN.Event()
        host = SPAWN.Process(target=serve, args=(kind, folder, address, ready, over))
        host.start()
        ready.wait()
        if kind == "sockets":
            places = dict.fromkeys(roles, folder / "client.json5")
        elif kind == "TCP":
            for path in places.values():
                write_client(path, f"tcp/{address}")
        yield places
        over.set()
        host.join()


def serve(kind: str, folder: Path, address: str, ready: Any, over: Any) -> None:
    """The process of a router."""
    if kind == "TCP":
        settings = zenoh.Config.from_file(str(shipped_file("zenoh_cfg/router.json5")))
        settings.insert_json5("listen/endpoints", json.dumps([f"tcp/{address}"]))
        settings.insert_json5("transport/link/protocols", '["tcp"]')
        hosted: Any = zenoh.open(settings)
    else:
        network = network_of(folder / "keys", address, PREFIX) if kind == "TLS" else None
        endpoint, hosted = open_router(network)
        write_client(folder / "client.json5", endpoint)
    with closing(hosted):
        ready.set()
        over.wait()
