"""Who may do what at a router that listens on a network:
roles by keys by verbs, and those who may do nothing.

A real `saltus router` on loopback, joined over TLS with real certificates.
"""

import contextlib
import json
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import zenoh

from saltus.cli.main import main
from saltus.errors import ConfigError, StackError
from saltus.wire.certificates import (
    create_authority,
    issue_certificate,
    load_authority,
    revoke_certificate,
)
from saltus.wire.joining import open_session
from saltus.wire.roles import LISTENERS, PROCESSES, ROLES
from saltus.wire.topics import SHARED, TOPICS

PREFIX = "robot/0"
SPEAKERS = (*PROCESSES, "operator")
MAY_PUT, MAY_READ = dict[str, set[str]](), dict[str, set[str]]()
for topic in TOPICS.values():
    for role in SPEAKERS if topic.publisher == "*" else (topic.publisher,):
        key = (
            f"{PREFIX}/{topic.name}/{role}" if topic.publisher == "*" else f"{PREFIX}/{topic.name}"
        )
        MAY_PUT[key], MAY_READ[key] = {"owner", role}, {"owner", *LISTENERS, *topic.readers}
    if topic.named:
        MAY_PUT[f"{key}/rear"], MAY_READ[f"{key}/rear"] = MAY_PUT[key], MAY_READ[key]
for key in (
    f"{PREFIX}/{SHARED}",
    f"{PREFIX}/status",
    f"{PREFIX}/other",
    "robot/1/policy/plan",
    "elsewhere",
):
    MAY_PUT[key] = {"owner"}
    MAY_READ[key] = {"owner", *LISTENERS} if key.startswith(PREFIX) else {"owner"}
EVERYTHING = ("**", f"**/{SHARED}")
"""Keys: the former is all that has no @ in it."""
SETTLE_S = 0.5
TIMEOUT_S = 20.0


@dataclass(frozen=True)
class Site:
    """A router with its authority, and what its owner's programs join with."""

    keys: Path
    address: str
    files: dict[str, Path]
    """Of each role, of "revoked" and of "expired"."""
    run_dir: Path


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    folder = tmp_path_factory.mktemp("site")
    keys, run_dir = folder / "keys", folder / "run"
    with socket.create_server(("127.0.0.1", 0)) as port:
        address = f"127.0.0.1:{port.getsockname()[1]}"
    assert main(["keys", "init", "--address", address, "--keys", str(keys)]) == 0
    files = {role: issue_certificate(keys, role, days=1) for role in ROLES}
    files["revoked"], files["expired"] = (
        issue_certificate(keys, "policy", days=1),
        issue_certificate(keys, "policy", days=0),
    )
    assert main(["keys", "revoke", files["revoked"].stem, "--keys", str(keys)]) == 0
    command = ["router", "--listen", address, "--keys", str(keys), "--out", str(run_dir)]
    with subprocess.Popen(
        [sys.executable, "-P", "-m", "saltus.cli.main", *command], stdout=subprocess.PIPE, text=True
    ) as router:
        assert router.stdout is not None
        assert router.stdout.readline().startswith("router at")
        yield Site(keys, address, files, run_dir)
        router.terminate()


@pytest.fixture(scope="module")
def sessions(site: Site) -> Iterator[dict[str, Any]]:
    """Of every role, of who was revoked, and of the owner's own programs."""
    with contextlib.ExitStack() as stack:
        yield {
            who: stack.enter_context(contextlib.closing(open_session("client", str(file))))
            for who, file in {**site.files, "owner": site.run_dir / "client.json5"}.items()
            if who != "expired"
        }


def until(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(SETTLE_S)  # what each put sets off takes its time


def test_each_role_puts_to_its_own_keys_alone(sessions: dict[str, Any]) -> None:
    met: set[tuple[str, str]] = set()
    for expression in EVERYTHING:
        sessions["owner"].declare_subscriber(
            expression, lambda it: met.add((str(it.key_expr), it.payload.to_string()))
        )
    expected = {(key, who) for key, some in MAY_PUT.items() for who in some}

    publishers = [
        (who, session.declare_publisher(key))
        for who, session in sessions.items()
        for key in MAY_PUT
    ]

    def put() -> bool:
        for who, publisher in publishers:
            publisher.put(who)
        return expected <= met

    until(put)
    for who, session in sessions.items():
        if who != "owner":
            session.put(f"{PREFIX}/**", who)
            session.delete(f"{PREFIX}/policy/plan")  # a delete has no payload
    time.sleep(SETTLE_S)
    assert met == expected


def test_a_role_that_comes_back_may_what_it_might(site: Site, sessions: dict[str, Any]) -> None:
    met: set[str] = set()
    sessions["heightmap"].declare_subscriber(
        f"{PREFIX}/camera/depth", lambda it: met.add(it.payload.to_string())
    )
    for time_ in range(3):
        with contextlib.closing(open_session("client", str(site.files["render"]))) as session:
            publisher = session.declare_publisher(f"{PREFIX}/camera/depth")
            until(
                lambda publisher=publisher, time_=time_: (
                    publisher.put(str(time_)) or str(time_) in met
                )
            )


def test_each_role_reads_its_own_keys_alone(sessions: dict[str, Any]) -> None:
    met: set[tuple[str, str]] = set()

    def listener(who: str) -> Callable[[Any], None]:
        return lambda it: (
            met.add((str(it.key_expr), who)) if it.payload.to_string() == "read" else None
        )

    for who, session in sessions.items():
        for expression in (*MAY_READ, *EVERYTHING, f"{PREFIX}/**"):
            session.declare_subscriber(expression, listener(who))
    expected = {(key, who) for key, some in MAY_READ.items() for who in some}

    publishers = [sessions["owner"].declare_publisher(key) for key in MAY_READ]

    def put() -> bool:
        for publisher in publishers:
            publisher.put("read")
        return expected <= met

    until(put)
    time.sleep(SETTLE_S)
    assert met == expected


def test_no_role_gets_or_answers(site: Site, sessions: dict[str, Any]) -> None:
    """No process answers queries; the owner's own programs may."""
    with contextlib.closing(open_session("client", str(site.run_dir / "client.json5"))) as other:
        for who, session in {**sessions, "other": other}.items():
            for expression in EVERYTHING:
                session.declare_queryable(
                    expression, lambda query, who=who: query.reply(query.key_expr, who)
                )
        until(lambda: answers(other, "elsewhere") == {"owner", "other"})
        for key in MAY_PUT:
            assert answers(other, key) == {"owner", "other"}
            for who, session in sessions.items():
                assert answers(session, key) == ({who} if who != "owner" else {"owner", "other"})


def answers(session: Any, key: str) -> set[str]:
    """Who answers; one's own queryable always does."""
    return {
        reply.ok.payload.to_string()
        for reply in session.get(key, timeout=1.0, consolidation=zenoh.ConsolidationMode.NONE)
        if reply.ok is not None
    }


def test_who_has_no_certificate_that_holds_does_not_join(site: Site, tmp_path: Path) -> None:
    """Expired, of another authority, without any, over plain TCP."""
    create_authority(tmp_path / "other", site.address, days=1)
    foreign = issue_certificate(tmp_path / "other", "policy", days=1)
    whole = json.loads(site.files["policy"].read_text())
    strangers = {
        "expired": json.loads(site.files["expired"].read_text()),
        "foreign": json.loads(foreign.read_text()),
    }
    for name in ("no certificate", "plain"):
        strangers[name] = json.loads(json.dumps(whole))
    for part in ("certificate", "private_key"):
        del strangers["no certificate"]["transport"]["link"]["tls"][f"connect_{part}_base64"]
    strangers["plain"]["connect"]["endpoints"] = [f"tcp/{site.address}"]
    strangers["plain"]["transport"]["link"]["protocols"] = ["tcp"]
    joined = []
    for name, settings in strangers.items():
        settings["connect"]["timeout_ms"] = 500
        with (
            contextlib.suppress(zenoh.ZError),
            zenoh.open(zenoh.Config.from_json5(json.dumps(settings))),
        ):
            joined.append(name)
    assert not joined


def test_a_holder_whose_certificate_does_not_hold_is_told_so(site: Site) -> None:
    with pytest.raises(StackError, match="refused this certificate"):
        open_session("client", str(site.files["expired"]))


def test_names_and_serials_never_return(tmp_path: Path) -> None:
    create_authority(tmp_path / "keys", "192.168.123.10:7447", days=1)
    for _ in range(3):
        revoke_certificate(
            tmp_path / "keys", issue_certificate(tmp_path / "keys", "viewer", days=1).stem
        )
    issued = load_authority(tmp_path / "keys").issued
    assert (
        len({each.serial for each in issued})
        == len({each.name for each in issued})
        == len(issued)
        == 4
    )
    assert not load_authority(tmp_path / "keys").names
    with pytest.raises(ConfigError, match="no certificate"):
        revoke_certificate(tmp_path / "keys", issued[-1].name)
    for path in (tmp_path / "keys").iterdir():
        assert path.suffix == ".pem" or path.stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("address", ["example.com:7447", "8.8.8.8:7447"])
def test_hosts_that_a_public_authority_knows_are_refused(address: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="public authority"):
        create_authority(tmp_path / "keys", address, days=1)
