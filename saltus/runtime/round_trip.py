"""How long messages take on this machine."""

import contextlib
import statistics
import time

from saltus.errors import StackError
from saltus.wire.messages import Done
from saltus.wire.router import open_router
from saltus.wire.zenoh_bus import ZenohBus

ANSWER_TIMEOUT_S = 0.1


def local_round_trip(messages: int = 50) -> float:
    """Median time of a small message from one client to another and back, through a router of this machine [s].

    Raises:
        StackError: no router can be had, or nothing arrives.
    """
    endpoint, router = open_router()
    times = []
    with contextlib.closing(router), ZenohBus(endpoint, "saltus") as here, ZenohBus(endpoint, "saltus") as there:
        ping, pong = here.publisher("done", "ping"), there.publisher("done", "pong")
        ping_in, pong_in = there.latest("done", "ping"), here.latest("done", "pong")
        for step in range(messages):
            start = time.perf_counter()
            ping.put(Done(time_ns=0, step=step, process="ping"))
            if ping_in.wait(ANSWER_TIMEOUT_S) is not None:
                pong.put(Done(time_ns=0, step=step, process="pong"))
                if pong_in.wait(ANSWER_TIMEOUT_S) is not None:
                    times.append(time.perf_counter() - start)
    if len(times) < messages // 2:  # the first are lost while the subscriptions travel
        raise StackError(f"of {messages} messages through a router {len(times)} came back")
    return statistics.median(times)
