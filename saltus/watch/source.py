"""Where a page has its scenes from: a recording, or a run,
live while it goes on and then from its recording.
"""

from bisect import bisect_right
from pathlib import Path

from saltus.errors import SaltusError
from saltus.recordings.recorder import RECORDING_FILE
from saltus.recordings.recording import Recording, read_recording
from saltus.runtime.run_folder import CLIENT_FILE
from saltus.watch.live import LiveRun
from saltus.watch.scene import LOOK_BACK_NS, Scene, SceneMaker, SceneWorld
from saltus.wire import messages
from saltus.wire.joining import LOCAL, read_client
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
        self.world = SceneWorld(
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


class SceneSource:
    """Scenes of one robot.

    Args:
        path: A recording, or a folder of a run, which need not be there yet.
        prefix: Of the robot's keys, where it is not the one that the folder names.
    """

    def __init__(self, path: Path, prefix: str = "") -> None:
        self.path = path
        self.prefix = prefix
        self.live: LiveRun | None = None
        self.recorded: RecordedRun | None = None
        self._joined: float | None = (
            None  # when the file was written by which it was last tried to join
        )
        self._read: float | None = None  # the same of the recording
        if path.is_file() or path.suffix == ".mcap":
            self.recorded = RecordedRun(path)

    @property
    def world(self) -> SceneWorld | None:
        """World of the run, which stays the same; None before it has begun."""
        run = self.live or self.recorded
        return None if run is None else run.world

    @property
    def name(self) -> str:
        """Name that tells this source from others: prefix of the robot, or file or folder."""
        return self.prefix or (
            self.path.parent.name if self.path.name == RECORDING_FILE else self.path.stem
        )

    @property
    def duration_s(self) -> float:
        """Duration of the recording [s]; 0 for what goes on."""
        return self.recorded.duration_s if self.live is None and self.recorded is not None else 0.0

    @property
    def may_ask(self) -> bool:
        """True where this is a run on this machine that goes on: its owner may do everything."""
        return (
            self.live is not None
            and not self.prefix
            and read_client(self.path / CLIENT_FILE).startswith(LOCAL)
        )

    def scene(self, time_s: float) -> Scene | None:
        """The scene of now, or of a time since the beginning of the recording [s];
        None before the run has begun.
        """
        if self.live is not None:
            return self.live.now()
        return (
            None
            if self.recorded is None
            else self.recorded.at(min(time_s, self.recorded.duration_s))
        )

    def look(self) -> bool:
        """Looks whether a run has begun or ended, and returns it.

        Quick where nothing has changed.
        """
        if self.live is not None:
            if self.live.connected():
                return False
            self.leave()
            # What is gone is not tried again until it is new
            self._joined = _written(self.path / CLIENT_FILE)
            self._read_recording()
            return True
        return self.path.suffix != ".mcap" and (
            self._join() or (self.recorded is None and self._read_recording())
        )

    def leave(self) -> None:
        """Stops to listen to a run that goes on; `look` joins it again."""
        if self.live is not None:
            self.live.__exit__()
            self.live, self._joined = None, None

    def _join(self) -> bool:
        client = self.path / CLIENT_FILE
        written = _written(client)
        if written is None or written == self._joined or not _answers(client):
            return False
        self._joined = written
        try:
            self.live = LiveRun(self.path, str(client), self.prefix)
        except SaltusError:  # of a run that is gone
            return False
        self.recorded = None
        return True

    def _read_recording(self) -> bool:
        recording = self.path / RECORDING_FILE
        written = _written(recording)
        if written is None or written == self._read or self.prefix:
            return False
        self._read = written
        try:
            self.recorded = RecordedRun(recording)
        except SaltusError:  # of a run that has only begun
            return False
        return True


def _written(file: Path) -> float | None:
    try:
        return file.stat().st_mtime
    except OSError:
        return None


def _answers(client: Path) -> bool:
    """True where the socket is there of the router that a file names.

    Over a network nobody knows before.
    """
    try:
        endpoint = read_client(client)
    except SaltusError:
        return False
    return not endpoint.startswith(LOCAL) or Path(endpoint.removeprefix(LOCAL)).exists()
