"""A run or a recording for Foxglove: its WebSocket on loopback, with the channels that a recording holds.

Nobody can ask anything of a run by it, but everybody on this machine can read: the protocol knows no secret.
"""

import queue
import time
from collections.abc import Iterable
from pathlib import Path

import foxglove
from foxglove.websocket import (
    Capability,
    ChannelView,
    Client,
    PlaybackCommand,
    PlaybackControlRequest,
    PlaybackState,
    PlaybackStatus,
    ServerListener,
)

from saltus.errors import MessageError, SaltusError
from saltus.recordings import viewer
from saltus.recordings.recording import Arrival
from saltus.recordings.ros_messages import definition_of
from saltus.recordings.viewer import Viewer
from saltus.watch.recorded import RecordedRun
from saltus.watch.source import Source
from saltus.wire import codec
from saltus.wire.bus import topic_of
from saltus.wire.messages import OPERATOR, SUPERVISOR
from saltus.wire.roles import PROCESSES
from saltus.wire.schemas import TYPE_NAME
from saltus.wire.topics import TOPICS

LAYOUT = Path(__file__).with_name("foxglove_layout.json")
LOOPBACK = "127.0.0.1"
SENT_HZ = 30.0  # enough for the eye: what has come in since is sent at once
LOOK_S = 0.5  # how often it looks whether the run has begun or ended
UNWATCHED_S = 0.2  # how often it looks whether somebody watches
SENDERS = (*PROCESSES, SUPERVISOR, OPERATOR)
"""Senders of topics of which each process has its own. A client that subscribes as soon as it is
told of a channel may be too quick for the SDK, which knows no such channel yet: those of others are
there when they speak, and may be missed."""
BACK_NS = 250_000_000  # before a moment that somebody jumps to: enough for one message of every derived topic


class Listener(ServerListener):
    """Requests of clients, which come by Foxglove's threads."""

    def __init__(self) -> None:
        self.subscribed: queue.SimpleQueue[str] = queue.SimpleQueue()
        """Topics to which somebody has subscribed."""
        self.asked: queue.SimpleQueue[PlaybackControlRequest] = queue.SimpleQueue()

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:  # noqa: ARG002 - as the SDK calls it
        """See `ServerListener`."""
        self.subscribed.put(channel.topic)

    def on_playback_control_request(self, playback_control_request: PlaybackControlRequest) -> None:
        """See `ServerListener`; it is answered by the thread that plays."""
        self.asked.put(playback_control_request)


class Studio:
    """Serves one source.

    Raises:
        SaltusError: the port is taken.
    """

    def __init__(self, source: Source, port: int) -> None:
        source.look()
        self._source = source
        self._playback = None if source.recorded is None else Playback(source.recorded)
        self._listener = Listener()
        self._context = foxglove.Context()
        self._viewer: Viewer | None = None
        self._looked_s = float("-inf")
        self._over = False
        try:
            self._server = foxglove.start_server(
                name="Saltus", host=LOOPBACK, port=port, context=self._context, capabilities=[Capability.Time],
                server_listener=self._listener,
                playback_time_range=None if self._playback is None else self._playback.span_ns,
            )  # fmt: skip
        except RuntimeError as error:
            raise SaltusError(f"Foxglove cannot be served at port {port}: {error}") from error
        self._channels: dict[str, foxglove.Channel] = {}
        for topic, (type_name, _) in viewer.TOPICS.items():
            self._channel(topic, type_name)
        for row in TOPICS.values():
            for sender in SENDERS if row.publisher == "*" else ("",):
                if row.recorded:
                    self._channel(f"/{row.name}/{sender}".rstrip("/"), TYPE_NAME[row.message])

    @property
    def address(self) -> str:
        """For Foxglove's "Open connection"."""
        return f"ws://{LOOPBACK}:{self._server.port}"

    @property
    def watched(self) -> bool:
        """True where somebody has subscribed to anything."""
        return any(channel.has_sinks() for channel in self._channels.values())

    def run(self) -> None:
        """Serves until the run has ended, recordings for ever."""
        last_s = time.monotonic()
        while not self._over:
            now_s = time.monotonic()
            self.step(now_s - last_s)
            last_s = now_s
            period_s = 1.0 / SENT_HZ if self.watched else UNWATCHED_S
            time.sleep(max(0.001, now_s + period_s - time.monotonic()))

    def step(self, seconds: float) -> None:
        """Sends what has come in, or what the recording holds of the seconds that follow."""
        if self._playback is not None:
            self._play(self._playback, seconds)
        elif not self.watched:
            self._source.leave()  # a run that nobody looks at is not listened to
            self._looked_s, self._viewer = float("-inf"), None
        else:
            if time.monotonic() - self._looked_s > LOOK_S:
                self._looked_s = time.monotonic()
                changed = self._source.look()
                self._over = changed and self._source.live is None
            self._send_live()

    def close(self) -> None:
        """Leaves the run and ends the server."""
        self._source.leave()
        self._server.stop()

    def _send_live(self) -> None:
        live = self._source.live
        if live is None:
            return
        if self._viewer is None:
            self._viewer = Viewer(live.world.robot, live.world.terrain)
        arrivals, now_ns = live.hear(), live.now_ns()
        self._repeat_first(self._viewer, now_ns)
        self._send(self._viewer, arrivals)
        self._server.broadcast_time(now_ns)

    def _play(self, playback: "Playback", seconds: float) -> None:
        while not self._listener.asked.empty():
            self._server.broadcast_playback_state(playback.obey(self._listener.asked.get()))
        if not self.watched:
            return
        arrivals, state = playback.advance(seconds)
        self._repeat_first(playback.viewer, max(0, playback.now_ns))
        self._send(playback.viewer, arrivals)
        self._server.broadcast_time(max(0, playback.now_ns))
        if state is not None:
            self._server.broadcast_playback_state(state)

    def _repeat_first(self, viewer_: Viewer, now_ns: int) -> None:
        """Says again what stands still, to a client that has just come."""
        topics = set()
        while not self._listener.subscribed.empty():
            topics.add(self._listener.subscribed.get())
        if topics:
            for message in viewer_.first():
                if message.topic in topics:
                    self._channel(message.topic, message.type_name).log(message.payload, log_time=now_ns)

    def _send(self, viewer_: Viewer, arrivals: Iterable[Arrival]) -> None:
        for row in arrivals:
            topic = topic_of(row.key)
            if topic is None or not topic.recorded:
                continue
            try:
                message = codec.decode(topic.message, row.payload)
            except MessageError:
                continue  # malformed: a recorder counts it
            time_ns = max(0, row.arrival_ns)
            self._channel(f"/{row.key}", TYPE_NAME[topic.message]).log(row.payload, log_time=time_ns)
            for derived in viewer_.derive(row.key, message, row.arrival_ns):
                self._channel(derived.topic, derived.type_name).log(derived.payload, log_time=time_ns)

    def _channel(self, topic: str, type_name: str) -> foxglove.Channel:
        if topic not in self._channels:
            schema = foxglove.Schema(name=type_name, encoding="ros2msg", data=definition_of(type_name).encode())
            self._channels[topic] = foxglove.Channel(
                topic, schema=schema, message_encoding="cdr", context=self._context
            )
        return self._channels[topic]


class Playback:
    """A recording that is played, over and over until somebody else wishes otherwise."""

    def __init__(self, recorded: RecordedRun) -> None:
        self.span_ns = recorded.span_ns
        self.now_ns = recorded.span_ns[0] - 1
        """All that came until then has been played."""
        self.viewer = Viewer(recorded.world.robot, recorded.world.terrain)
        self._recorded = recorded
        self._playing, self._speed = True, 1.0
        self._from_ns: int | None = None

    def obey(self, request: PlaybackControlRequest) -> PlaybackState:
        """Plays, pauses or jumps as a client asks."""
        self._playing = request.playback_command == PlaybackCommand.Play
        self._speed = request.playback_speed
        if request.seek_time is not None:
            self._jump(request.seek_time)
        return self._state(did_seek=request.seek_time is not None, request_id=request.request_id)

    def advance(self, seconds: float) -> tuple[list[Arrival], PlaybackState | None]:
        """Messages of the next seconds of this machine; and what to tell clients, where the recording begins anew."""
        start_ns, end_ns = self.span_ns
        state = None
        if self._playing and self.now_ns >= end_ns:
            self._jump(start_ns - 1)
            state = self._state(did_seek=True)
        after_ns = self.now_ns if self._from_ns is None else self._from_ns
        self._from_ns = None
        if self._playing:
            self.now_ns = min(end_ns, self.now_ns + round(1e9 * seconds * self._speed))
        return list(self._recorded.arrivals(after_ns, self.now_ns)), state

    def _jump(self, time_ns: int) -> None:
        self.now_ns = min(max(time_ns, self.span_ns[0] - 1), self.span_ns[1])
        self._from_ns = self.now_ns - BACK_NS
        world = self._recorded.world
        self.viewer = Viewer(world.robot, world.terrain)

    def _state(self, *, did_seek: bool, request_id: str | None = None) -> PlaybackState:
        return PlaybackState(
            status=PlaybackStatus.Playing if self._playing else PlaybackStatus.Paused,
            current_time=max(0, self.now_ns), playback_speed=self._speed, did_seek=did_seek, request_id=request_id,
        )  # fmt: skip
