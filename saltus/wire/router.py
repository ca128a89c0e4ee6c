"""A Zenoh router on loopback, and the one file with which any Zenoh program joins it."""

import json
import socket
from pathlib import Path
from typing import Any

import zenoh

from saltus.errors import StackError
from saltus.resources import resource

PORT_ATTEMPTS = 5


def open_router(endpoint: str | None = None) -> tuple[str, Any]:
    """Opens a Zenoh router, by default on a free port of loopback; returns its endpoint and its session.

    Raises:
        StackError: it cannot listen there.
    """
    for _ in range(PORT_ATTEMPTS):
        listens = endpoint or f"tcp/127.0.0.1:{_free_port()}"
        settings = zenoh.Config.from_file(str(resource("zenoh_cfg/router.json5")))
        try:
            settings.insert_json5("listen/endpoints", json.dumps([listens]))
            return listens, zenoh.open(settings)
        except zenoh.ZError as error:  # of a free port: somebody else took it in between
            last = error
        if endpoint is not None:
            reason = str(last).split(" at /")[0]  # without places in the source of Zenoh
            raise StackError(f"cannot host a Zenoh router at {endpoint}: {reason}; is another one running there?")
    raise StackError(f"cannot host a Zenoh router on 127.0.0.1: {last}")


def write_client(path: Path, endpoint: str) -> None:
    """Writes a configuration of Zenoh with which any program joins a router: `zenoh.Config.from_file(path)`.

    Only the owner of the JSON5 file can read it.
    """
    path.touch(mode=0o600)
    path.write_text(f"{_client(endpoint)}\n")


def read_client(path: Path) -> str:
    """The endpoint that a file of `write_client` names; `StackError` where it names none."""
    if not path.is_file():
        raise StackError(f"there is no {path}: it is written by saltus up, demo and router; or name an --endpoint")
    try:
        endpoints = json.loads(zenoh.Config.from_file(str(path)).get_json("connect/endpoints"))
    except (zenoh.ZError, ValueError) as error:
        raise StackError(f"{path} is no configuration of Zenoh: {error}") from error
    if not isinstance(endpoints, list) or not endpoints:
        raise StackError(f"{path} names no endpoint to connect to")
    return str(endpoints[0])


def _client(endpoint: str) -> zenoh.Config:
    settings = zenoh.Config.from_file(str(resource("zenoh_cfg/client.json5")))
    settings.insert_json5("connect/endpoints", json.dumps([endpoint]))
    return settings


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
