"""Foxglove: a client of its protocol that knows no type decodes every channel, live and of a recording."""

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from foxglove.websocket import PlaybackCommand, PlaybackStatus
from plain_reader import messages_of
from recorded import MS, STEPS, raw, run_samples, write
from speaker import EVENT, speaking
from studio import StudioClient, studio

from saltus.recordings import viewer
from saltus.recordings.ros_messages import STORE
from saltus.watch.foxglove import BACK_NS, LAYOUT, Playback
from saltus.watch.recorded import RecordedRun
from saltus.wire.schemas import TYPE_NAME
from saltus.wire.topics import TOPICS

pytestmark = pytest.mark.slow

RAW = {f"/{name}" for name, row in TOPICS.items() if row.recorded and row.publisher != "*"}
EVERYTHING = {*viewer.TOPICS, *RAW, "/event/heightmap", "/status/controller"}


def check_types(client: StudioClient) -> None:
    """Channels have the types of the tables, and say what they mean."""
    found = {channel["topic"]: channel["schemaName"] for channel in client.channels.values()}
    derived = {topic: name for topic, (name, _) in viewer.TOPICS.items()}
    own = {f"/{name}": TYPE_NAME[row.message] for name, row in TOPICS.items()}
    assert set(found) >= EVERYTHING
    assert found == {topic: derived.get(topic) or own.get(topic) or own[topic.rpartition("/")[0]] for topic in found}


def test_a_run_that_goes_on_is_decoded_channel_by_channel(tmp_path: Path) -> None:
    folder = tmp_path
    with speaking(folder) as ended, studio(str(folder), folder=folder) as (client, process):
        client.until(lambda c: set(c.received) >= EVERYTHING, "not everything has come")
        check_types(client)
        assert client.info["capabilities"] == ["time"]  # nobody can ask anything of a run by it
        for topic, rows in client.received.items():
            assert rows == sorted(rows, key=lambda row: row[0]), topic
        assert client.times == sorted(client.times)
        ended.set()
        assert process.stdout is not None
        assert "read it" in process.stdout.readline()
        assert f"the run has ended; its recording: saltus watch --foxglove {folder}" in process.stdout.readline()
        assert process.wait(30.0) == 0


def test_a_recording_is_played_as_its_file_has_it(tmp_path: Path) -> None:
    path = write(tmp_path / "run.mcap", [*run_samples(), raw("event/heightmap", EVENT, 1)]).path
    held: dict[str, set[bytes]] = {}
    for topic, _, _, payload in messages_of(path):
        held.setdefault(topic, set()).add(payload)
    with studio(str(path), folder=tmp_path) as (client, _):
        client.until(lambda c: set(c.received) >= EVERYTHING, "not everything has come")
        client.until(lambda c: len(c.received["/controller/state"]) >= 2 * STEPS, "it is not played again")
        check_types(client)
        assert client.info["capabilities"] == ["time", "playbackControl"]
        end = client.info["dataEndTime"]
        assert 10**9 * end["sec"] + end["nsec"] == RecordedRun(path).span_ns[1]
        for topic, rows in client.received.items():
            assert {payload for _, _, payload in rows} <= held[topic]


def ask(playback: Playback, command: PlaybackCommand, seek_ns: int | None = None, speed: float = 1.0) -> Any:
    request: Any = SimpleNamespace(playback_command=command, playback_speed=speed, seek_time=seek_ns, request_id="one")
    return playback.obey(request)


def test_playing_pausing_and_jumping(tmp_path: Path) -> None:
    recorded = RecordedRun(write(tmp_path / "run.mcap", list(run_samples())).path)
    start_ns, end_ns = recorded.span_ns
    everything = [row.payload for row in recorded.arrivals(-1, end_ns)]
    playback = Playback(recorded)
    played: list[bytes] = []
    while playback.now_ns < end_ns:
        arrivals, state = playback.advance(0.0137)
        assert state is None
        played += [row.payload for row in arrivals]
    assert played == everything
    _, state = playback.advance(0.0)
    assert state is not None
    assert (state.status, state.did_seek, state.current_time) == (PlaybackStatus.Playing, True, max(0, start_ns - 1))
    middle = (start_ns + end_ns) // 2
    answer = ask(playback, PlaybackCommand.Pause, middle)
    assert (answer.status, answer.current_time, answer.did_seek, answer.request_id) == (
        PlaybackStatus.Paused, middle, True, "one",
    )  # fmt: skip
    shown, _ = playback.advance(1.0)
    assert [row.payload for row in shown] == [r.payload for r in recorded.arrivals(middle - BACK_NS, middle)]
    assert playback.advance(1.0) == ([], None)  # it stands still
    ask(playback, PlaybackCommand.Play, speed=0.5)
    slow, _ = playback.advance(0.02)
    assert [row.payload for row in slow] == [r.payload for r in recorded.arrivals(middle, middle + 10 * MS)]
    answer = ask(playback, PlaybackCommand.Pause, end_ns + 10**12)
    assert answer.current_time == end_ns


def test_the_layout_names_only_what_is_there() -> None:
    layout = json.loads(LAYOUT.read_text())
    panels = layout["configById"]
    named, fields = set(), []
    for config in panels.values():
        named |= set(config.get("topics", {}))
        named |= {config[key] for key in ("topicToRender",) if key in config}
        named |= {value for key, value in config.get("imageMode", {}).items() if key.endswith("Topic")}
        fields += [path["value"].split(".") for path in config.get("paths", ())]
    assert named | {topic for topic, _ in fields} <= set(viewer.TOPICS)
    assert set(viewer.TOPICS) - named - {"/viewer/numbers", "/viewer/tf", "/viewer/depth"} == set()
    for topic, field in fields:
        assert field in STORE.types[viewer.TOPICS[topic][0]].__dataclass_fields__
    shown = set(re.findall(r'"([A-Za-z0-9]+![a-z]+)"', json.dumps(layout["layout"])))
    assert shown == set(panels)
    grid = panels["3D!robot"]["topics"]["/viewer/grid_map"]
    assert (grid["elevationLayer"], grid["colorLayer"]) == ("elevation", "variance")
