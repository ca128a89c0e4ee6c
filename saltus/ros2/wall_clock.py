"""Times of a run and times of ROS, which count from 1970."""

import time

from saltus.config import RunConfig


class WallClock:
    """Turns times of a run into those of ROS and back [ns].

    In lockstep simulated time has nothing to do with a clock: ROS is told the simulated time
    itself.
    """

    def __init__(self, config: RunConfig) -> None:
        self._lockstep = config.pace == "lockstep"
        self._speed = config.speed
        self._start_ns = time.time_ns() - time.monotonic_ns() + config.epoch_ns

    def wall_ns(self, run_ns: int) -> int:
        """Time since 1970 of a time of the run."""
        return run_ns if self._lockstep else self._start_ns + round(run_ns / self._speed)

    def run_ns(self, wall_ns: int) -> int:
        """Time of the run of a time since 1970."""
        return wall_ns if self._lockstep else round((wall_ns - self._start_ns) * self._speed)
