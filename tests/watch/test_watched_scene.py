"""Scenes: they know what came before and nothing that came later,
and are the same live and from a recording.
"""

import time
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded import LATENCY_NS, MS, STEPS, run_messages, run_samples, write
from samples import put_run

from saltus.config import RunConfig, to_toml
from saltus.recordings.recording import RecordedMessage
from saltus.runtime.run_folder import RUN_FILE
from saltus.watch.live import LiveRun
from saltus.watch.scene import SILENT, Scene
from saltus.watch.source import RecordedRun
from saltus.wire.codec import Envelope
from saltus.wire.messages import ControllerMode, HeightmapStatus
from saltus.wire.router import open_router
from saltus.wire.topics import TOPICS
from saltus.wire.zenoh_bus import ZenohBus

STEP_S = 0.01
PATIENCE_S = 20.0


def plain(value: Any) -> Any:
    """A scene as what can be compared."""
    if hasattr(value, "__dataclass_fields__"):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, tuple):
        return [plain(item) for item in value]
    return np.asarray(value).tolist() if isinstance(value, np.ndarray) else value


def same(one: Scene, other: Scene, *left_out: str) -> None:
    for field in fields(Scene):
        if field.name not in left_out:
            np.testing.assert_equal(
                plain(getattr(one, field.name)), plain(getattr(other, field.name)), field.name
            )


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RecordedRun:
    return RecordedRun(
        write(tmp_path_factory.mktemp("run") / "recording.mcap", list(run_samples())).path
    )


def test_a_scene_knows_nothing_that_came_later(run: RecordedRun, tmp_path: Path) -> None:
    for steps in (1, 2, 7, STEPS - 1):
        cut = RecordedRun(write(tmp_path / f"{steps}.mcap", list(run_samples(steps))).path)
        same(cut.at((steps - 1) * STEP_S), run.at((steps - 1) * STEP_S))


def test_a_scene_shows_the_newest_of_what_was_sent(run: RecordedRun) -> None:
    for step in (0, 5, STEPS - 1):
        sent = dict(run_messages(step))
        scene = run.at(step * STEP_S)
        truth, heightmap = sent["plant/truth"], sent["heightmap/heightmap"]
        assert scene.base_pose is not None
        assert scene.heights is not None
        assert scene.heights.true is not None
        assert scene.mode == ControllerMode.RUN
        assert scene.heights.status == HeightmapStatus.OK
        base = truth.position_base_in_world  # type: ignore[union-attr]
        np.testing.assert_array_equal(scene.base_pose[:3], base)
        np.testing.assert_allclose(scene.heights.predicted[:, 2] - base[2], heightmap.height)  # type: ignore[union-attr]
        np.testing.assert_allclose(scene.heights.true[:, 2] - base[2], truth.height)  # type: ignore[union-attr]
        ahead = np.linalg.norm(scene.heights.predicted[:, :2] - base[:2], axis=1)
        np.testing.assert_allclose(ahead, np.abs(heightmap.x))  # type: ignore[union-attr]


def test_ages_and_states_are_those_of_the_table_of_topics(run: RecordedRun) -> None:
    """At times beyond the last message, all topics grow old:
    on time, degraded, not to be used, silent.
    """
    world, maker = run.world, run._maker
    topic, sent_ns = TOPICS["policy/plan"], 1_000 * MS
    payload = next(s.payload for s in run_samples() if s.key == topic.name)
    row = RecordedMessage(
        sent_ns + LATENCY_NS, topic.name, Envelope(1, sent_ns, bytes(16)), payload
    )
    ages = {
        0: "ok",
        topic.degraded_age_s: "ok",
        topic.invalid_age_s: "degraded",
        1.0: "invalid",
        -0.1: "future",
    }
    for age_s, status in ages.items():
        scene = maker.make([row], sent_ns + round(1e9 * age_s), ())
        shown = {each.name: each for each in scene.topics}
        assert (shown[topic.name].status, shown[topic.name].age_ms) == (
            status,
            pytest.approx(1e3 * age_s),
        )
        assert shown["controller/state"].status == SILENT
    assert world.config.seed == 7


def test_a_malformed_message_is_not_drawn(run: RecordedRun) -> None:
    rows = [
        RecordedMessage(MS, key, Envelope(1, MS, bytes(16)), payload)
        for key in (
            "plant/truth",
            "controller/state",
            "camera/depth",
            "heightmap/heightmap",
            "policy/plan",
            "status/x",
        )
        for payload in (b"", b"\x00\x01\x00\x00junk")
    ]
    scene = run._maker.make(rows, 2 * MS, ())
    assert scene.base_pose is scene.depth is scene.heights is scene.mode is None
    assert np.isnan(scene.planned_feet).all()


@pytest.mark.parametrize("shared", [True, False])
def test_a_run_that_is_watched_gives_the_scenes_of_its_recording(
    tmp_path: Path, *, shared: bool
) -> None:
    """In lockstep to the bit: only the numbers of messages differ, of which the first are lost.

    The page hears by the run's supervisor, or, at a router without one, itself.
    """
    config = RunConfig(robot="go1", grid="line", seed=7)
    (put_run(tmp_path, config) / RUN_FILE).write_text(to_toml(config))
    endpoint, router = open_router(speed=config.link_speed)
    try:
        with LiveRun(tmp_path, endpoint) as live, ZenohBus.of_run(endpoint, config) as bus:
            until_s = time.monotonic() + PATIENCE_S
            publishers = {
                key: bus.publisher(*key.split("/controller")[:1])
                for key, _ in run_messages(0)
                if "/" in key
            }
            publishers["status/controller"] = bus.publisher("status", "controller")
            stream, sharer = bus.stream(), bus.sharer()

            def now() -> Scene:
                if shared:
                    sharer.take(stream.drain())
                return live.now()

            while (scene := now()).heights is None:
                assert time.monotonic() < until_s, "nothing arrives"
                for key, message in run_messages(0):
                    publishers[key].put(message)
                time.sleep(0.05)
            for step in range(STEPS):
                for key, message in run_messages(step):
                    publishers[key].put(message)
                while now().time_s < step * STEP_S:
                    assert time.monotonic() < until_s, f"the messages of step {step} do not arrive"
            while (
                scene.time_s < (STEPS - 1) * STEP_S
                or scene.heights is None
                or scene.topics[3].age_ms > 0.0
            ):
                assert time.monotonic() < until_s, "the last message does not arrive"
                time.sleep(0.01)
                scene = now()
    finally:
        router.close()
    recorded = RecordedRun(write(tmp_path / "recording.mcap", list(run_samples())).path)
    same(scene, recorded.at((STEPS - 1) * STEP_S), "topics")
