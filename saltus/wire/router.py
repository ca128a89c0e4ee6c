"""A Zenoh router that only its owner can reach, and over a network those who have a certificate."""

import contextlib
import json
import os
import shutil
import tempfile
from dataclasses import dataclass
from resource import RLIMIT_NOFILE, getrlimit, setrlimit

import zenoh

from saltus.errors import StackError
from saltus.resources import shipped_file
from saltus.wire.joining import LOCAL, ClientCertificate, lease_slowed, mutual_tls

RECEIVING_THREADS = 16
"""Threads of a process that hosts a router; Zenoh makes them for its first session. In lockstep one
waits for each sender whose message does not fit into a full link. With the 2 of the default both
wait for the recorder, a session of the same process, which needs one of them to receive. A run has
5 senders; programs of its user come on top."""
os.environ.setdefault(
    "ZENOH_RUNTIME",
    # Else one thread learns that a socket has something, and wakes another to read it
    f"(rx: (worker_threads: {RECEIVING_THREADS}), acc: (handover: rx), net: (handover: rx))",
)


@dataclass(frozen=True, kw_only=True)
class NetworkAccess:
    """Where a router listens for programs of other computers or users, and which it lets in."""

    listen: str
    """Where, e.g. tls/192.168.123.10:7447."""
    certificate: ClientCertificate
    """The router's."""
    access_control: dict[str, object]
    """Rights of each certificate, as Zenoh's configuration says them."""


def open_router(
    network: NetworkAccess | None = None, speed: float = 1.0
) -> tuple[str, contextlib.ExitStack]:
    """Opens a Zenoh router at a socket in a new folder that nobody but its owner may enter,
    and on a network if asked.

    `speed` is that of the run's clock, see `lease_slowed`.

    Returns:
        The endpoint of that socket, and what to close the router with.

    Raises:
        StackError: it cannot listen there.
    """
    with contextlib.ExitStack() as resources:
        # Mode 0700; the path of a socket has at most 107 characters
        folder = tempfile.mkdtemp(prefix="saltus-")
        resources.callback(shutil.rmtree, folder, ignore_errors=True)
        endpoints = [f"{LOCAL}{folder}/router"]
        settings = zenoh.Config.from_file(str(shipped_file("zenoh_cfg/router.json5")))
        lease_slowed(settings, speed)
        try:
            if network is not None:
                # each stranger who connects holds a file until refused
                setrlimit(RLIMIT_NOFILE, (getrlimit(RLIMIT_NOFILE)[1],) * 2)
                endpoints.append(network.listen)
                settings.insert_json5(
                    "transport/link/tls", json.dumps(mutual_tls(network.certificate, "listen"))
                )
                settings.insert_json5("access_control", json.dumps(network.access_control))
            settings.insert_json5("listen/endpoints", json.dumps(endpoints))
            resources.callback(zenoh.open(settings).close)
        except zenoh.ZError as error:
            # Without places in Zenoh's source
            reason, places = (
                str(error).split(" at /")[0],
                " and ".join(endpoints),
            )
            raise StackError(
                f"cannot host a Zenoh router at {places}: {reason}; is another one there?"
            ) from error
        return endpoints[0], resources.pop_all()
