"""Who may join a router: the secret of a run, and the one file with which any Zenoh program of its owner joins."""

import json
import secrets
import socket
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import zenoh

from saltus.errors import StackError
from saltus.resources import resource

USER = "saltus"
"""The one name under which all who have the secret join."""
_AUTH, _ENDPOINTS = "transport/auth/usrpwd", "connect/endpoints"
_LOOK_S = 1.0  # for a port to take a connection


@dataclass(frozen=True, kw_only=True)
class Access:
    """What it takes to join a router."""

    endpoint: str
    """Where it listens, e.g. tcp/127.0.0.1:7447."""
    secret: str | None = field(default=None, repr=False)
    """What it asks for; None where a router of somebody else's lets everybody in."""


def new_secret() -> str:
    """256 random bits, as text."""
    return secrets.token_urlsafe(32)


def open_session(role: Literal["router", "peer", "client"], access: Access) -> Any:
    """Opens a session of Zenoh with `zenoh_cfg/<role>.json5`; routers and peers let in only who has the secret.

    Raises:
        StackError: the endpoint cannot be understood, nobody answers there, or the secret is not the router's.
        zenoh.ZError: a router cannot listen there.
    """
    settings = _settings(role, access)
    # Zenoh reads whom it lets in from a file, once, when it opens; what is deleted then nobody can read
    with tempfile.NamedTemporaryFile("w", prefix="saltus-") as users:  # mode 0600
        if access.secret is not None and role != "client":
            users.write(f"{USER}:{access.secret}\n")
            users.flush()
            settings.insert_json5(f"{_AUTH}/dictionary_file", json.dumps(users.name))
        try:
            return zenoh.open(settings)
        except zenoh.ZError as error:
            if role == "router":
                raise
            raise StackError(_refusal(access, error)) from error


def write_client(path: Path, access: Access) -> None:
    """Writes a configuration of Zenoh with which any program joins a router: `zenoh.Config.from_file(path)`.

    Only the owner of the JSON5 file can read it.
    """
    path.unlink(missing_ok=True)  # one that is there may be readable by others
    path.touch(mode=0o600)
    path.write_text(f"{_settings('client', access)}\n")


def read_client(path: Path) -> Access:
    """What a file of `write_client` says; `StackError` where it names no endpoint."""
    if not path.is_file():
        raise StackError(f"there is no {path}: it is written by saltus up, demo and router; or name an --endpoint")
    try:
        settings = zenoh.Config.from_file(str(path))
        endpoints = json.loads(settings.get_json(_ENDPOINTS))
        secret = json.loads(settings.get_json(f"{_AUTH}/password"))
    except (zenoh.ZError, ValueError) as error:
        raise StackError(f"{path} is no configuration of Zenoh: {error}") from error
    if not isinstance(endpoints, list) or not endpoints:
        raise StackError(f"{path} names no endpoint to connect to")
    return Access(endpoint=str(endpoints[0]), secret=secret)


def _settings(role: str, access: Access) -> zenoh.Config:
    settings = zenoh.Config.from_file(str(resource(f"zenoh_cfg/{role}.json5")))
    try:
        settings.insert_json5("listen/endpoints" if role == "router" else _ENDPOINTS, json.dumps([access.endpoint]))
    except zenoh.ZError as error:
        raise StackError(f"'{access.endpoint}' is no endpoint: one looks like tcp/127.0.0.1:7447") from error
    if access.secret is not None:
        settings.insert_json5(_AUTH, json.dumps({"user": USER, "password": access.secret}))
    return settings


def _refusal(access: Access, error: zenoh.ZError) -> str:
    """Why a session could not be opened: Zenoh says no more than that it could not."""
    host, _, port = access.endpoint.partition("/")[2].rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=_LOOK_S).close()
    except (OSError, ValueError):
        return f"no Zenoh router at {access.endpoint}: {error}"
    return f"the router at {access.endpoint} let nobody in with this secret: is its client.json5 that of another run?"
