"""A recorded run, any moment of it."""

from bisect import bisect_right
from pathlib import Path

from saltus.recordings.recording import Recording, read_recording
from saltus.watch.scene import LOOK_BACK_NS, Scene, SceneMaker, World
from saltus.wire import messages
from saltus.wire.topics import TOPICS

DRAWN = (
    messages.DepthFrame,
    messages.Event,
    messages.GroundTruth,
    messages.Heightmap,
    messages.JointPlan,
    messages.MotionPlan,
    messages.ProcessStatus,
    messages.RobotState,
)


class RecordedRun:
    """Scenes of a recording.

    Raises:
        RecordingError: it cannot be read, or was written by another version.
    """

    def __init__(self, recording: Path | Recording) -> None:
        if isinstance(recording, Path):
            recording = read_recording(recording)
        for name, topic in TOPICS.items():
            if topic.message in DRAWN:
                next(recording.messages(name), None)  # refuses fields of another version
        self._recording = recording
        self._start_ns, end_ns = recording.span_ns
        self.duration_s = 1e-9 * (end_ns - self._start_ns)
        """From the first message to the last [s]."""
        self.world = World(
            title=_title(recording),
            config=recording.known_config,
            robot=recording.robot,
            terrain=recording.terrain,
            camera=recording.camera,
        )
        self._maker = SceneMaker(self.world)
        found = [
            (ns, event)
            for ns, _, event in recording.messages("event")
            if isinstance(event, messages.Event)
        ]
        self._event_ns, self._events = [ns for ns, _ in found], tuple(event for _, event in found)

    def at(self, time_s: float) -> Scene:
        """The scene so long after the first message [s]."""
        return self.at_ns(self._start_ns + round(1e9 * time_s))

    def at_ns(self, now_ns: int) -> Scene:
        """The scene at a time of the run's clock [ns]."""
        arrivals = self._recording.arrivals(now_ns - LOOK_BACK_NS, now_ns)
        return self._maker.make(
            arrivals, now_ns, self._events[: bisect_right(self._event_ns, now_ns)]
        )


def _title(recording: Recording) -> str:
    seed = f", seed {recording.config.seed}" if recording.config is not None else ""
    return f"{recording.terrain.kind.replace('_', ' ')}{seed}"
