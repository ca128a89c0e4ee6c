"""Who may join a router: the secret of a run, and the one file with which any Zenoh program of its owner joins."""

import base64
import ipaddress
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
"""The one name under which all who have the run's secret join."""
NETWORK_USER = "network"
"""The one under which those join who have a certificate."""
_AUTH, _ENDPOINTS, _TLS = "transport/auth/usrpwd", "connect/endpoints", "transport/link/tls"
_LOOK_S = 1.0  # for a port to take a connection


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """A certificate, its key, and the certificate of who issued it and those of the others, all in PEM."""

    authority: bytes
    certificate: bytes
    key: bytes = field(repr=False)


@dataclass(frozen=True, kw_only=True)
class Access:
    """What it takes to join a router."""

    endpoint: str
    """Where it listens, e.g. tcp/127.0.0.1:7447."""
    secret: str | None = field(default=None, repr=False)
    """What it asks for; None where a router of somebody else's lets everybody in."""
    user: str = USER
    """Who asks to join."""
    file: Path | None = None
    """Configuration of Zenoh that says all this, and more where one joins over a network."""


@dataclass(frozen=True, kw_only=True)
class Network:
    """How a router lets others in than those of its own machine."""

    listen: str
    """Where, e.g. tls/192.168.123.10:7447."""
    certificate: Certificate
    """The router's."""
    secret: str = field(repr=False)
    """What it asks for besides a certificate."""
    access_control: dict[str, Any]
    """What each certificate may, as Zenoh's configuration says it."""


def new_secret() -> str:
    """256 random bits, as text."""
    return secrets.token_urlsafe(32)


def open_session(role: Literal["router", "peer", "client"], access: Access, network: Network | None = None) -> Any:
    """Opens a session of Zenoh with `zenoh_cfg/<role>.json5`; routers and peers let in only who has the secret.

    With `network` a router listens there too, for who has a certificate.

    Raises:
        StackError: the endpoint cannot be understood, nobody answers there, or the secret is not the router's.
        zenoh.ZError: a router cannot listen there.
    """
    settings = _settings(role, access)
    # Zenoh reads whom it lets in from a file, once, when it opens; what is deleted then nobody can read
    with tempfile.NamedTemporaryFile("w", prefix="saltus-") as users:  # mode 0600
        if access.secret is not None and role != "client":
            users.write(f"{USER}:{access.secret}\n")
            if network is not None:
                users.write(f"{NETWORK_USER}:{network.secret}\n")
                _open_to(settings, access, network)
            users.flush()
            settings.insert_json5(f"{_AUTH}/dictionary_file", json.dumps(users.name))
        try:
            return zenoh.open(settings)
        except zenoh.ZError as error:
            if role == "router":
                raise
            raise StackError(_refusal(access, error)) from error


def loopback(endpoint: str) -> bool:
    """Whether only this machine reaches an endpoint; so it is taken to be of one that Zenoh will not understand."""
    host = endpoint.partition("/")[2].rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host in ("localhost", "")


def write_client(path: Path, access: Access, certificate: Certificate | None = None) -> None:
    """Writes a configuration of Zenoh with which any program joins a router: `zenoh.Config.from_file(path)`.

    Only the owner of the JSON5 file can read it.
    """
    settings = json.loads(str(_settings("client", access)))
    if certificate is not None:  # which Zenoh's own text of a configuration leaves out
        settings["transport"]["link"] |= {"protocols": ["tls"], "tls": _mutual(certificate, "connect")}
    path.unlink(missing_ok=True)  # one that is there may be readable by others
    path.touch(mode=0o600)
    path.write_text(f"{json.dumps(settings)}\n")


def read_client(path: Path) -> Access:
    """What a file of `write_client` says; `StackError` where it names no endpoint."""
    if not path.is_file():
        raise StackError(f"there is no {path}: it is written by saltus up, demo and router; or name an --endpoint")
    try:
        settings = zenoh.Config.from_file(str(path))
        endpoints = json.loads(settings.get_json(_ENDPOINTS))
        secret, user = (json.loads(settings.get_json(f"{_AUTH}/{name}")) for name in ("password", "user"))
    except (zenoh.ZError, ValueError) as error:
        raise StackError(f"{path} is no configuration of Zenoh: {error}") from error
    if not isinstance(endpoints, list) or not endpoints:
        raise StackError(f"{path} names no endpoint to connect to")
    return Access(endpoint=str(endpoints[0]), secret=secret, user=user or USER, file=path)


def _settings(role: str, access: Access) -> zenoh.Config:
    file = access.file if role == "client" else None
    settings = zenoh.Config.from_file(str(file or resource(f"zenoh_cfg/{role}.json5")))
    try:
        settings.insert_json5("listen/endpoints" if role == "router" else _ENDPOINTS, json.dumps([access.endpoint]))
    except zenoh.ZError as error:
        raise StackError(f"'{access.endpoint}' is no endpoint: one looks like tcp/127.0.0.1:7447") from error
    if access.secret is not None and file is None:
        settings.insert_json5(_AUTH, json.dumps({"user": access.user, "password": access.secret}))
    return settings


def _open_to(settings: zenoh.Config, access: Access, network: Network) -> None:
    settings.insert_json5("listen/endpoints", json.dumps([access.endpoint, network.listen]))
    settings.insert_json5("transport/link/protocols", json.dumps(["tcp", "tls"]))
    settings.insert_json5(_TLS, json.dumps(_mutual(network.certificate, "listen")))
    settings.insert_json5("access_control", json.dumps(network.access_control))


def _mutual(own: Certificate, side: Literal["connect", "listen"]) -> dict[str, Any]:
    """Zenoh's settings with which both ends of a link must show a certificate that holds."""
    texts = {
        "root_ca_certificate": own.authority, f"{side}_certificate": own.certificate, f"{side}_private_key": own.key,
    }  # fmt: skip
    settings: dict[str, Any] = {f"{name}_base64": base64.b64encode(pem).decode() for name, pem in texts.items()}
    return settings | {"enable_mtls": True, "verify_name_on_connect": True, "close_link_on_expiration": True}


def _refusal(access: Access, error: zenoh.ZError) -> str:
    """Why a session could not be opened: Zenoh says no more than that it could not."""
    host, _, port = access.endpoint.partition("/")[2].rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=_LOOK_S).close()
    except (OSError, ValueError):
        return f"no Zenoh router at {access.endpoint}: {error}"
    if access.endpoint.startswith("tls/"):
        return f"the router at {access.endpoint} refused this certificate, or has one that {access.file} does not trust"
    return f"the router at {access.endpoint} let nobody in with this secret: is its client.json5 that of another run?"
