"""Counts images that a camera sent and the service never used."""

from collections import deque

WINDOW_NS = 1_000_000_000


class FrameLoss:
    """Counts the numbers that are missing between the images of the last second."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._missing: deque[tuple[int, int]] = deque()

    def accept(self, frame_id: int, time_ns: int) -> None:
        """Takes note of an image that is used, in order of capture.

        A lower number than the last is a new count.
        """
        missing = 0 if self._last is None else frame_id - self._last - 1
        self._last = frame_id
        if missing > 0:
            self._missing.append((time_ns, missing))

    def count(self, now_ns: int) -> int:
        """Images that were lost before those captured within the last second."""
        while self._missing and now_ns - self._missing[0][0] > WINDOW_NS:
            self._missing.popleft()
        return sum(missing for _, missing in self._missing)
