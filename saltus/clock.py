"""The clock of a run."""

import time
from collections.abc import Callable

from saltus.config import RunConfig
from saltus.errors import ConfigError


class RunClock:
    """The clock of a run: nanoseconds since its start.

    In real time it is the monotonic clock of the machine minus `epoch_ns`, times `speed`, so all
    processes agree. All rates, ages and limits of a run are in this clock, so that the same code
    with the same limits runs on a computer that is too slow for real time. In lockstep it stands at
    the time that the caller has set: that of the step being answered.
    """

    def __init__(self, epoch_ns: int = 0, *, lockstep: bool = False, speed: float = 1.0) -> None:
        self.epoch_ns = epoch_ns
        self.lockstep = lockstep
        self.speed = speed
        self._now_ns = 0

    @classmethod
    def of(cls, config: RunConfig) -> "RunClock":
        """The clock of a run that has begun: its start is in its configuration."""
        return cls(config.epoch_ns, lockstep=config.pace == "lockstep", speed=config.speed)

    def now_ns(self) -> int:
        """Time of the run [ns]."""
        return self._now_ns if self.lockstep else self.elapsed_ns()

    def elapsed_ns(self) -> int:
        """Time since the start, at the speed of the run, also in lockstep:
        for watching over processes [ns].
        """
        return self.of_monotonic(time.monotonic_ns())

    def elapsed_s(self) -> float:
        """`elapsed_ns` in seconds."""
        return 1e-9 * self.elapsed_ns()

    def within(self, run_s: float, machine_s: float) -> Callable[[], bool]:
        """A function that is True until `run_s` seconds of the run are over.

        In lockstep also only for `machine_s` seconds of the machine: the run may stand still.
        """
        until_s, standstill_s = self.elapsed_s() + run_s, time.monotonic() + machine_s
        return lambda: (
            self.elapsed_s() < until_s and (not self.lockstep or time.monotonic() < standstill_s)
        )

    def set(self, time_ns: int) -> None:
        """Lockstep: moves the clock to the step being answered. It never goes back.

        Raises:
            ConfigError: in real time nobody sets the clock.
        """
        if not self.lockstep:
            raise ConfigError('the clock of a real-time run cannot be set: use pace = "lockstep"')
        self._now_ns = max(self._now_ns, time_ns)

    def of_monotonic(self, monotonic_ns: int) -> int:
        """A monotonic time of this machine (an arrival) in the run's clock of real time [ns]."""
        machine_ns = monotonic_ns - self.epoch_ns
        return machine_ns if self.speed == 1.0 else round(machine_ns * self.speed)

    def machine_s(self, run_s: float) -> float:
        """How long `run_s` seconds of the run take on this machine [s]."""
        return run_s / self.speed
