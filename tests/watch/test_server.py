"""The page's server: on loopback alone, and nothing for who does not have the token."""

import contextlib
import http.client
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from saltus.cli.main import main
from saltus.watch.server import PageServer

VERSION = Subprotocol(f"viser-v{viser.__version__}")


@pytest.fixture(scope="module")
def server() -> Iterator[PageServer]:
    server = PageServer(0)
    yield server
    server.stop()


def wrong_paths(token: str) -> list[str]:
    return [
        "/", "", "/index.html", f"/?token={token}", f"/x/{token}/", f"/{token}x/",
        f"/{token[:-1]}/",
        f"/{token.swapcase()}/", f"//{token[1:]}/", f"/%2e%2e/{token}x", "/" + "a" * len(token),
    ]  # fmt: skip


def get(server: PageServer, path: str) -> tuple[int, bytes, dict[str, str]]:
    with contextlib.closing(
        http.client.HTTPConnection("127.0.0.1", server.get_port(), timeout=10)
    ) as link:
        link.request("GET", path or "/")
        answer = link.getresponse()
        return answer.status, answer.read(), dict(answer.headers)


def test_who_has_the_address_gets_the_page_and_the_websocket(server: PageServer) -> None:
    path = "/" + server.address.split("/", 3)[3]
    status, page, headers = get(server, path)
    assert status == 200
    assert b"<html" in page
    assert headers["Referrer-Policy"] == "no-referrer"  # the token leaves the page to nobody
    with connect(server.address.replace("http", "ws").rstrip("/"), subprotocols=[VERSION]) as link:
        assert len(link.recv(timeout=10)) > 0


def test_nobody_else_gets_the_page_or_the_websocket(server: PageServer) -> None:
    for path in wrong_paths(server.token):
        status, text, _ = get(server, path)
        assert status == 403, path
        assert b"token" in text
        assert b"<html" not in text
        with pytest.raises(InvalidStatus, match="403"):
            connect(f"ws://127.0.0.1:{server.get_port()}{path}", subprotocols=[VERSION])


def test_other_computers_find_no_port(server: PageServer) -> None:
    """The socket is bound to 127.0.0.1: at any other address of this computer nothing listens."""
    for address in ("127.0.0.2", *socket.gethostbyname_ex(socket.gethostname())[2]):
        if address != "127.0.0.1":
            with pytest.raises(ConnectionRefusedError):
                socket.create_connection((address, server.get_port()), timeout=5)


def test_tokens_are_new_and_cannot_be_guessed(server: PageServer) -> None:
    other = PageServer(0)
    try:
        assert other.token != server.token
        assert len(other.token) >= 20
        assert get(other, f"/{server.token}/")[0] == 403
    finally:
        other.stop()


def test_no_page_opens_a_tunnel(server: PageServer) -> None:
    assert server.request_share_url() is None


@pytest.mark.parametrize("command", ["watch", "demo --watch"])
def test_without_viser_one_line_says_what_to_install(
    command: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "viser", None)  # as where it is not installed
    assert main(command.split()) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert "viser" in said[0]
    assert "pip install 'saltus[watch]'" in said[0]
    assert list(tmp_path.iterdir()) == []
