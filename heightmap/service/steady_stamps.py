"""Stamps of recorded images: those that go back or jump are told, and replayed without the jump."""

from collections import deque

import numpy as np

from saltus.wire.topics import CAMERA_PERIOD_S

JUMP_S = 1.0
"""Between two images; the slowest depth cameras take 6 a second, and some of those are lost."""
_RECENT = 31  # as many as show the period, some of them lost


class SteadyStamps:
    """Times of a recording's images on a clock that goes on, and how many stamps did not.

    An image that is stamped no later than the one before is taken to follow it by a period, one
    that is stamped more than `JUMP_S` later by that.

    Attributes:
        count: Images whose stamps went back, stayed or jumped.
        largest_s: The largest of these steps, with its sign [s].
    """

    def __init__(self) -> None:
        self.count, self.largest_s = 0, 0.0
        self._stamped_ns: int | None = None
        self._time_ns = 0
        self._steps_ns: deque[int] = deque([round(1e9 * CAMERA_PERIOD_S)], _RECENT)

    @property
    def period_s(self) -> float:
        """Time from one image to the next, the median of the last ones [s]."""
        return 1e-9 * float(np.median(self._steps_ns))

    def step(self, stamp_ns: int) -> int:
        """When an image was taken, on a clock that begins at the first stamp and goes on [ns]."""
        before_ns, self._stamped_ns = self._stamped_ns, stamp_ns
        if before_ns is None:
            self._time_ns = stamp_ns
            return stamp_ns
        step_ns, most_ns = stamp_ns - before_ns, round(1e9 * JUMP_S)
        if 0 < step_ns <= most_ns:
            self._steps_ns.append(step_ns)
        else:
            self.count += 1
            self.largest_s = max(self.largest_s, 1e-9 * step_ns, key=abs)
            step_ns = min(step_ns, most_ns) if step_ns > 0 else round(1e9 * self.period_s)
        self._time_ns += step_ns
        return self._time_ns

    def note(self) -> str:
        """One line about the stamps that did not go on; empty where all did."""
        if not self.count:
            return ""
        return (
            f"stamps of images go back, stay or jump {self.count} times, by {self.largest_s:+.6g} "
            "s "
            "at most: replayed as if the camera had gone on; do not rely on heights around there"
        )
