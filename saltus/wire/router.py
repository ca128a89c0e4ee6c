"""A Zenoh router on loopback, which only those join who have its secret."""

import socket
from typing import Any

import zenoh

from saltus.errors import StackError
from saltus.wire.access import Access, Network, new_secret, open_session

PORT_ATTEMPTS = 5


def open_router(endpoint: str | None = None, network: Network | None = None) -> tuple[Access, Any]:
    """Opens a Zenoh router with a secret of its own, by default on a free port of loopback, and on a network if asked.

    Returns:
        What it takes to join it, and its session.

    Raises:
        StackError: it cannot listen there.
    """
    secret = new_secret()
    for _ in range(PORT_ATTEMPTS):
        access = Access(endpoint=endpoint or f"tcp/127.0.0.1:{_free_port()}", secret=secret)
        try:
            return access, open_session("router", access, network)
        except zenoh.ZError as error:  # of a free port: somebody else took it in between
            last = error
        if endpoint is not None or network is not None:
            reason = str(last).split(" at /")[0]  # without places in the source of Zenoh
            places = " and ".join(place for place in (endpoint, network and network.listen) if place)
            raise StackError(f"cannot host a Zenoh router at {places}: {reason}; is another one running there?")
    raise StackError(f"cannot host a Zenoh router on 127.0.0.1: {last}")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
