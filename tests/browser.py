"""A browser without a window, led by Chrome's DevTools protocol:
what a page says and draws, and clicks on it.
"""

import base64
import contextlib
import itertools
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
from websockets.sync.client import ClientConnection, connect

PROGRAM = "chromium-headless-shell"
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu-sandbox", "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--hide-scrollbars", "--remote-debugging-port=0",
    "--no-first-run",
)  # fmt: skip
PATIENCE_S = 120.0
TEN_FRAMES = (
    "new Promise(done => { let left = 10; const f = () => left-- ? requestAnimationFrame(f) : "
    "done(); f(); })"
)
CODES = {"End": 35, "Home": 36}


class Tab:
    """One page of the browser."""

    def __init__(self, link: ClientConnection) -> None:
        self._link = link
        self._numbers = itertools.count(1)

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Calls a method of the protocol and returns its result."""
        number = next(self._numbers)
        self._link.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._link.recv(timeout=PATIENCE_S))
            if answer.get("id") == number:
                assert "error" not in answer, answer
                result: dict[str, Any] = answer["result"]
                return result

    def run(self, script: str) -> Any:
        """The value of a piece of JavaScript."""
        return self.ask("Runtime.evaluate", expression=script, returnByValue=True)["result"].get(
            "value"
        )

    def open(self, address: str) -> None:
        self.ask("Page.navigate", url=address)

    def text(self) -> str:
        """All that can be read on the page."""
        return str(self.run("document.body ? document.body.innerText : ''"))

    def until(self, seen: Callable[[], Any], what: str) -> Any:
        """What `seen` returns, as soon as it is true."""
        until_s = time.monotonic() + PATIENCE_S
        while not (found := seen()):
            assert time.monotonic() < until_s, f"{what} did not come; the page says:\n{self.text()}"
            time.sleep(0.05)
        return found

    def click(self, label: str) -> None:
        """Presses the button with this label."""
        press = (
            "(() => { const button = [...document.querySelectorAll('button')].find(each => "
            "each.innerText.trim() === "
            f"{json.dumps(label)}); if (!button) return false; button.click(); return true; }})()"
        )
        self.until(lambda: self.run(press), f"the button {label}")

    def choose(self, shown: str, other: str) -> None:
        """Takes another value of the list that shows this one."""
        find = "[...document.querySelectorAll('input')]"
        find += f".find(each => each.type === 'text' && each.value === {json.dumps(shown)})"
        option = (
            f"[...document.querySelectorAll('[role=option]')].find(o => o.innerText === "
            f"{json.dumps(other)})"
        )
        self.until(
            lambda: self.run(f"(() => {{ const i = {find}; i && i.click(); return !!i; }})()"),
            shown,
        )
        self.until(
            lambda: self.run(f"(() => {{ const o = {option}; o && o.click(); return !!o; }})()"),
            other,
        )

    def press(self, key: str) -> None:
        """Presses a key that moves what has the focus: "Home", "End"."""
        for kind in ("keyDown", "keyUp"):
            self.ask(
                "Input.dispatchKeyEvent",
                type=kind,
                key=key,
                code=key,
                windowsVirtualKeyCode=CODES[key],
            )

    def settled(self, look: Callable[[], np.ndarray]) -> np.ndarray:
        """What is seen when it no longer changes for ten frames."""
        seen = look()

        def same() -> bool:
            nonlocal seen
            self.ask("Runtime.evaluate", expression=TEN_FRAMES, awaitPromise=True)
            before, seen = seen, look()
            return bool(np.array_equal(before, seen))

        self.until(same, "a picture that stands still")
        return seen

    def picture(self) -> np.ndarray:
        """What the page looks like (RGB), shape (height, width, 3)."""
        data = base64.b64decode(self.ask("Page.captureScreenshot", format="png")["data"])
        return cv2.cvtColor(
            cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB
        )


@contextlib.contextmanager
def browser(width: int = 1280, height: int = 800) -> Iterator[Tab]:
    """A tab of a new browser; it is gone afterwards."""
    program = shutil.which(PROGRAM)
    assert program, f"tests of the page need {PROGRAM}: tools/libraries.sh tests"
    with tempfile.TemporaryDirectory() as profile, subprocess.Popen(
        [program, *FLAGS, f"--window-size={width},{height}", f"--user-data-dir={profile}",
            "about:blank"],
        stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, start_new_session=True,
    ) as process:  # fmt: skip
        try:
            assert process.stderr is not None
            line = next(line for line in process.stderr if line.startswith("DevTools listening on"))
            with connect(line.split()[-1], max_size=None) as link:
                root = Tab(link)
                target = root.ask("Target.createTarget", url="about:blank")["targetId"]
                port = line.split()[-1].split("/")[2]
                with connect(f"ws://{port}/devtools/page/{target}", max_size=None) as page:
                    yield Tab(page)
        finally:
            os.killpg(process.pid, signal.SIGKILL)  # it has started processes of its own
