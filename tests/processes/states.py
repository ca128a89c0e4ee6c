"""A process that publishes robot states at 100 Hz,
as a controller does, until the time limit of the run.
"""

import sys
from dataclasses import replace

from saltus.runtime.process import ProcessContext, run_process
from saltus.runtime.ticker import Ticker
from saltus.states import standing_state


def body(context: ProcessContext) -> None:
    states = context.bus.publisher("controller/state")
    context.ready()
    ticker = Ticker(100.0, clock=context.clock)
    while not context.stopped and ticker.ticks < 100 * context.config.time_limit_s:
        ticker.wait()
        context.beat(ticks=ticker.ticks, overruns=ticker.overruns)
        states.put(
            replace(
                standing_state(context.setup.robot),
                step=ticker.ticks,
                time_ns=context.clock.now_ns(),
            )
        )


if __name__ == "__main__":
    sys.exit(run_process("states", body))
