"""A process that takes what comes on every topic and answers with proof of life alone."""

import sys

from saltus.runtime.process import ProcessContext, run_process
from saltus.wire.topics import TOPICS


def body(context: ProcessContext) -> None:
    slots = [
        context.bus.latest(name, "probe" if t.publisher == "*" else "")
        for name, t in TOPICS.items()
    ]
    context.ready()
    ticks = 0
    while not context.stopped:
        ticks += sum(slot.take() is not None for slot in slots)
        context.beat(ticks=ticks)
        slots[0].wait(0.005)


if __name__ == "__main__":
    sys.exit(run_process("consumer", body))
