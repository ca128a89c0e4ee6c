"""Common parts of the tests of a bus over Zenoh:
the run, the limit of their patience, and a message.
"""

import time
from collections.abc import Callable

from saltus.config import RunConfig
from saltus.wire.messages import Done

# Nothing is lost on its links, however busy the computer: senders wait
RUN = RunConfig(robot="go1", grid="line", pace="lockstep")
PREFIX = RUN.prefix
TIMEOUT_S = 10.0


def done(step: int) -> Done:
    return Done(time_ns=10_000_000 * step, step=step, process="render", frame_id=step)


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < deadline, "nothing came"
        time.sleep(0.001)
