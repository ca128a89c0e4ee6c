"""A Zenoh router that only its owner can reach, and the one file with which any Zenoh program joins it."""

import contextlib
import json
import secrets
import shutil
import tempfile
from pathlib import Path

import zenoh

from saltus.errors import StackError
from saltus.resources import resource

LOCAL = "unixsock-stream/"
"""What endpoints of sockets in folders begin with."""


def open_router(endpoint: str | None = None) -> tuple[str, contextlib.ExitStack]:
    """Opens a Zenoh router, by default at a socket in a new folder that nobody but its owner may enter.

    Returns:
        Its endpoint, and what to close it with.

    Raises:
        StackError: it cannot listen there.
    """
    with contextlib.ExitStack() as resources:
        if endpoint is None:
            folder = tempfile.mkdtemp(prefix="saltus-")  # mode 0700; the path of a socket has at most 107 characters
            resources.callback(shutil.rmtree, folder, ignore_errors=True)
            endpoint = f"{LOCAL}{folder}/router"
        settings = zenoh.Config.from_file(str(resource("zenoh_cfg/router.json5")))
        try:
            settings.insert_json5("listen/endpoints", json.dumps([endpoint]))
            resources.callback(zenoh.open(settings).close)
        except zenoh.ZError as error:
            reason = str(error).split(" at /")[0]  # without places in the source of Zenoh
            raise StackError(
                f"cannot host a Zenoh router at {endpoint}: {reason}; is another one running there?"
            ) from error
        return endpoint, resources.pop_all()


def place_beside(endpoint: str) -> str:
    """Where a peer of a router listens: in the router's folder.

    Raises:
        StackError: the router is not in a folder of its owner.
    """
    if not endpoint.startswith(LOCAL):
        raise StackError(f"peers link directly only beside a router in a folder of their owner, not at {endpoint}")
    return f"{endpoint.rpartition('/')[0]}/{secrets.token_hex(8)}"


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
