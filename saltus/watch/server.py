"""The web server of the page: on loopback alone,
and for nobody without the token in its address.
"""

import contextlib
import hmac
import http
import secrets
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import rich
import viser
import websockets.asyncio.server as websocket_server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from saltus.errors import SaltusError

LOOPBACK = "127.0.0.1"
TOKEN_BYTES = 16  # cannot be guessed
HARDENING = {
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "X-Frame-Options": "DENY",
}
"""Other pages never learn the address, and cannot frame the buttons."""

HttpHandler = Callable[[object, Request], Response | None]


class PageServer(viser.ViserServer):
    """viser's server, at `address`."""

    def __init__(self, port: int) -> None:
        rich.get_console().quiet = (
            True  # viser tells its address, which is of no use without the token
        )
        self.token = secrets.token_urlsafe(TOKEN_BYTES)
        with _guarded(self.token) as guarded:
            super().__init__(host=LOOPBACK, port=port, label="Saltus", verbose=False)
        if not guarded:  # another version of viser
            self.stop()
            raise SaltusError(
                "this version of viser starts its server in another way: install viser 1.1"
            )

    @property
    def address(self) -> str:
        """Address of the page; whoever has it may watch and press buttons."""
        return f"http://{LOOPBACK}:{self.get_port()}/{self.token}/"

    def request_share_url(self, verbose: bool = True) -> None:
        """Does nothing, in place of viser's: no page may ask for a tunnel to the world."""


@contextlib.contextmanager
def _guarded(token: str) -> Iterator[list[bool]]:
    """Makes websocket servers that are opened meanwhile ask for the token.

    Filled where one was opened.
    """
    opened: list[bool] = []
    serve = websocket_server.serve

    def guarded(*arguments: Any, process_request: HttpHandler, **options: Any) -> Any:
        opened.append(True)
        return serve(*arguments, process_request=_asking(token, process_request), **options)

    websocket_server.serve = guarded  # type: ignore[assignment,misc]
    try:
        yield opened
    finally:
        websocket_server.serve = serve  # type: ignore[misc]


def _asking(token: str, answer: HttpHandler) -> HttpHandler:
    """Answers requests, of pages and of websockets, whose path begins with the token."""

    def asking(connection: object, request: Request) -> Response | None:
        given, _, rest = request.path.partition("?")[0].lstrip("/").partition("/")
        if not hmac.compare_digest(given.encode(), token.encode()):
            text = b"The address of this page has a token: copy all of what saltus watch prints.\n"
            headers = Headers(
                {"Content-Length": str(len(text)), "Content-Type": "text/plain", **HARDENING}
            )
            return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", headers, text)
        response = answer(connection, replace(request, path=f"/{rest}"))
        if response is not None:
            response.headers.update(HARDENING)
        return response

    return asking
