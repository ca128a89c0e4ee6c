"""A client of Foxglove's WebSocket protocol (foxglove.sdk.v1): subscribes to every channel that it is told of."""

import json
import struct
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from page import page_of
from plain_reader import PlainReader
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

SUBPROTOCOL = Subprotocol("foxglove.sdk.v1")
MESSAGE, TIME = 1, 2  # opcodes of what a server sends in binary
PATIENCE_S = 60.0


class StudioClient:
    """What a client has been told."""

    def __init__(self, link: ClientConnection) -> None:
        self.info: dict[str, Any] = {}
        self.channels: dict[int, dict[str, Any]] = {}
        self.received: dict[str, list[tuple[int, Any, bytes]]] = {}
        """Log time, message and payload, by topic."""
        self.times: list[int] = []
        self._link, self._reader = link, PlainReader()

    def until(self, condition: Any, what: str) -> None:
        """Receives until a condition of this client holds."""
        until_s = time.monotonic() + PATIENCE_S
        while not condition(self):
            assert time.monotonic() < until_s, f"{what}: {sorted(self.received)}"
            try:
                self._take(self._link.recv(timeout=1.0))
            except TimeoutError:
                continue

    @property
    def topics(self) -> set[str]:
        """Of the channels that there are."""
        return {channel["topic"] for channel in self.channels.values()}

    def _take(self, frame: str | bytes) -> None:
        if isinstance(frame, str):
            said = json.loads(frame)
            if said["op"] == "serverInfo":
                self.info = said
            elif said["op"] == "advertise":
                new = {channel["id"]: channel for channel in said["channels"]}
                self.channels |= new
                wanted = [{"id": number, "channelId": number} for number in new]
                self._link.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        elif frame[0] == MESSAGE:
            number, time_ns = struct.unpack_from("<IQ", frame, 1)
            channel, payload = self.channels[number], frame[13:]
            assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
            message = self._reader.decode(channel["schemaName"], channel["schema"], payload)
            self.received.setdefault(channel["topic"], []).append((time_ns, message, payload))
        elif frame[0] == TIME:
            self.times.append(struct.unpack_from("<Q", frame, 1)[0])


@contextmanager
def studio(*arguments: str, folder: Path) -> Iterator[tuple[StudioClient, "subprocess.Popen[str]"]]:
    """`saltus watch --foxglove` with these arguments, as a user starts it, and a client of it."""
    command = ("watch", "--foxglove", "--port", "0", *arguments)
    with (
        page_of(*command, folder=folder, scheme="ws") as (address, process),
        connect(address, subprotocols=[SUBPROTOCOL], max_size=None) as link,
    ):
        yield StudioClient(link), process
