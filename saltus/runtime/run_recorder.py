"""The recording of a run whose supervisor has other things to do:
what waits is bounded, a full disk ends no run.
"""

import json
from collections import deque
from collections.abc import Callable, Sequence

from saltus.clock import RunClock
from saltus.errors import RecordingError
from saltus.recordings.recorder import Recorder
from saltus.wire.bus import STREAM_CAPACITY, RawSample
from saltus.wire.messages import SUPERVISOR

RECORDED_AT_A_TIME = 80
"""Samples, of some 600 a second: on a busy computer the processes are looked after although the
recording is behind."""


class RunRecorder:
    """Records the messages of a run that this process hosts, in their order, a few at a time."""

    def __init__(self, recorder: Recorder, clock: RunClock, failed: Callable[[str], None]) -> None:
        """Calls `failed` once, with the reason, where the recording cannot be written any more."""
        self.error: str | None = None
        """Why the recording ended early."""
        self.waiting: deque[RawSample] = deque()
        """Samples that are not written yet."""
        self._recorder, self._clock, self._failed = recorder, clock, failed
        self._left_out = 0

    def take(self, samples: Sequence[RawSample]) -> None:
        """Lets samples wait, as many as there is room for, and writes some of those that wait."""
        room = STREAM_CAPACITY - len(self.waiting)
        self._left_out += max(0, len(samples) - room)
        self.waiting.extend(samples[:room])
        self._write(RECORDED_AT_A_TIME)

    def close(
        self, summary: dict[str, str], rejected: dict[str, dict[str, int]], missed: int
    ) -> None:
        """Writes all that waits and ends the file.

        Args:
            summary: What its end says, besides the messages that were refused.
            rejected: Messages that each process refused, by "topic/reason".
            missed: Samples that were lost before they came here.
        """
        self._write(len(self.waiting))
        self._recorder.missed = missed + self._left_out
        all_rejected = {**rejected, SUPERVISOR: dict(self._recorder.rejected)}
        try:
            self._recorder.close({**summary, "rejected": json.dumps(all_rejected)})
        except RecordingError as failure:
            self.error = self.error or str(failure)

    def _write(self, most: int) -> None:
        """Writes and flushes; on a full disk the robot still has to land."""
        try:
            for _ in range(0 if self.error else min(len(self.waiting), most)):
                self._recorder.write(self.waiting.popleft())
                if self._clock.lockstep:
                    self._clock.set(self._recorder.simulated_ns)
            if self.error is None:
                self._recorder.flush()
        except RecordingError as error:
            self.error = str(error)
            self._failed(self.error)
