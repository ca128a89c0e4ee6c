"""A loop of fixed rate."""

import time

from saltus.clock import RunClock


class Ticker:
    """Wakes a loop at a fixed rate by absolute deadlines of a clock, by default the machine's.

    A late tick is followed at once by the next, but by `catch_up` of them at most: the ticks that
    are missed beyond that are counted as overruns and left out, so that a stall never ends in a
    long burst. 1 is for hardware, which cannot make up for lost time; more for a simulation, whose
    time would fall behind the run's clock.
    """

    def __init__(self, rate_hz: float, catch_up: int = 1, clock: RunClock | None = None) -> None:
        self._clock = clock or RunClock()
        self.period_ns = round(1e9 / rate_hz)
        self.catch_up = catch_up
        self.ticks = 0
        self.overruns = 0
        self._deadline_ns: int | None = None

    def wait(self) -> int:
        """Sleeps until the next tick; returns how many ticks were left out before it.

        The first call returns at once and starts the schedule.
        """
        now = self._clock.elapsed_ns()
        if self._deadline_ns is None:
            self._deadline_ns = now
        else:
            self._deadline_ns += self.period_ns
        missed = max(0, (now - self._deadline_ns) // self.period_ns - (self.catch_up - 1))
        self._deadline_ns += missed * self.period_ns
        left_ns = self._deadline_ns - now
        while left_ns > 0:
            time.sleep(self._clock.machine_s(1e-9 * left_ns))
            left_ns = self._deadline_ns - self._clock.elapsed_ns()
        self.ticks += 1
        self.overruns += missed
        return missed
