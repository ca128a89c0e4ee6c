"""How a process joins a Zenoh router: by an endpoint,
or by the one file with which any Zenoh program joins.
"""

import base64
import json
import secrets
import socket
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import zenoh

from saltus.errors import StackError
from saltus.files import atomic_write
from saltus.resources import shipped_file

LOCAL = "unixsock-stream/"
"""Beginning of the endpoints of sockets in folders."""
_ENDPOINTS = "connect/endpoints"
_LEASE = "transport/link/tx/lease"  # [ms]
_LOOK_S = 1.0  # for a port to take a connection


@dataclass(frozen=True, kw_only=True)
class ClientCertificate:
    """A certificate, its key, and the certificate of who issued it and those of the others,
    all in PEM.
    """

    authority: bytes
    certificate: bytes
    key: bytes = field(repr=False)


def open_session(
    role: Literal["peer", "client"], endpoint: str, speed: float = 1.0, *, dates: bool = False
) -> zenoh.Session:
    """Opens a session of Zenoh with `zenoh_cfg/<role>.json5`.

    A client's file of `write_client` holds all of it.

    Args:
        role: Peers link directly, beside a router of their owner.
        endpoint: Of the router, e.g. tcp/127.0.0.1:7447, or the path of a file of `write_client`.
        speed: Of the run's clock, see `lease_slowed`; a client's file has its own.
        dates: Whether Zenoh dates what comes in, by the system's clock.

    Raises:
        StackError: the endpoint cannot be understood, nobody answers there, or peers cannot link
            beside it.
    """
    from_file = endpoint.endswith(".json5")
    router = read_client(Path(endpoint)) if from_file else endpoint
    settings = (
        zenoh.Config.from_file(endpoint)
        if from_file and role == "client"
        else _settings(role, router, speed)
    )
    settings.insert_json5("timestamping/enabled", json.dumps(dates))
    if role == "peer":
        if not router.startswith(LOCAL):
            raise StackError(
                "peers link directly only beside a router in a folder of their owner, not at "
                f"{router}"
            )
        settings.insert_json5(
            "listen/endpoints", json.dumps([f"{router.rpartition('/')[0]}/{secrets.token_hex(8)}"])
        )
    try:
        return zenoh.open(settings)
    except zenoh.ZError as error:
        why = f": its run is over, or has not begun; {endpoint} names it" if from_file else ""
        raise StackError(f"{_refusal(router)}{why}") from error


def write_client(
    path: Path, endpoint: str, certificate: ClientCertificate | None = None, speed: float = 1.0
) -> None:
    """Writes a configuration of Zenoh with which any program joins a router:
    `zenoh.Config.from_file(path)`.

    Only the owner of the JSON5 file can read it. `speed` is that of the run's clock, see
    `lease_slowed`.
    """
    settings = json.loads(str(_settings("client", endpoint, speed)))
    if certificate is not None:  # which Zenoh's own text of a configuration leaves out
        settings["transport"]["link"] |= {
            "protocols": ["tls"],
            "tls": mutual_tls(certificate, "connect"),
        }
    with atomic_write(path) as partial:
        partial.unlink(missing_ok=True)  # one that is there may be readable by others
        partial.touch(mode=0o600)
        partial.write_text(f"{json.dumps(settings)}\n", encoding="utf-8")


def read_client(path: Path) -> str:
    """The endpoint that a file of `write_client` names; `StackError` where it names none."""
    if not path.is_file():
        raise StackError(
            f"there is no {path}: it is written by saltus up, demo and router; or name an "
            "--endpoint"
        )
    try:
        endpoints = json.loads(zenoh.Config.from_file(str(path)).get_json(_ENDPOINTS))
    except (zenoh.ZError, ValueError) as error:
        raise StackError(f"{path} is no configuration of Zenoh: {error}") from error
    if not isinstance(endpoints, list) or not endpoints:
        raise StackError(f"{path} names no endpoint to connect to")
    return str(endpoints[0])


def mutual_tls(own: ClientCertificate, side: Literal["connect", "listen"]) -> dict[str, object]:
    """Zenoh's settings with which both ends of a link must show a certificate that holds."""
    texts = {
        "root_ca_certificate": own.authority, f"{side}_certificate": own.certificate,
        f"{side}_private_key": own.key,
    }  # fmt: skip
    settings: dict[str, object] = {
        f"{name}_base64": base64.b64encode(pem).decode() for name, pem in texts.items()
    }
    return settings | {
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
    }


def lease_slowed(settings: zenoh.Config, speed: float) -> None:
    """Lets links last as long in the run's clock,
    of which `speed` seconds pass in one of the machine.

    Who stands still for longer than the lease loses its links, and with them what is sent until it
    has new ones.
    """
    settings.insert_json5(_LEASE, json.dumps(round(json.loads(settings.get_json(_LEASE)) / speed)))


def _settings(role: str, endpoint: str, speed: float) -> zenoh.Config:
    settings = zenoh.Config.from_file(str(shipped_file(f"zenoh_cfg/{role}.json5")))
    lease_slowed(settings, speed)
    try:
        settings.insert_json5(_ENDPOINTS, json.dumps([endpoint]))
    except zenoh.ZError as error:
        raise StackError(
            f"'{endpoint}' is no endpoint: one looks like tcp/127.0.0.1:7447"
        ) from error
    return settings


def _refusal(router: str) -> str:
    """Why a session could not be opened: Zenoh says no more than that it could not,
    and where in its source.
    """
    host, _, port = router.removeprefix("tls/").rpartition(":")
    if router.startswith("tls/"):
        try:
            socket.create_connection((host.strip("[]"), int(port)), timeout=_LOOK_S).close()
        except (OSError, ValueError):
            pass
        else:
            return (
                f"the router at {router} refused this certificate, "
                "or has one that its file does not trust"
            )
    return f"no Zenoh router at {router}"
