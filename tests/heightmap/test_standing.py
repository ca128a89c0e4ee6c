"""Heights of a robot that stands are trusted, unless something is wrong.

Then that is named, and nothing else.
"""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lockstep_run import recorded_run
from samples import setup_of

from saltus.cli.main import main
from saltus.config import RunConfig, TerrainConfig
from saltus.grid import SCAN
from saltus.heightmap.evaluation.trust_checks import PLACE, check_standing
from saltus.recordings.recorder import Recorder
from saltus.recordings.recording import Recording, read_recording
from saltus.robots.robot import Robot
from saltus.wire import codec
from saltus.wire.bus import RawSample
from saltus.wire.codec import Envelope
from saltus.wire.messages import (
    ControllerMode,
    DepthFrame,
    Heightmap,
    HeightmapStatus,
    Message,
    RobotState,
)
from saltus.wire.topics import TOPICS

MS = 1_000_000
Change = Callable[[Any, int], "Message | None"]


@pytest.fixture(scope="module")
def standing(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A robot stands for a second before it jumps."""
    folder = tmp_path_factory.mktemp("standing")
    config = RunConfig(
        robot="go1", grid="line", terrain=TerrainConfig(terrain="flat"), planner="scripted",
        camera="d435i", time_limit_s=0.5,
    )  # fmt: skip
    return recorded_run(folder, config)


def changed(
    recording: Recording, path: Path, kind: type[Message], change: Change, robot: Robot | None
) -> Recording:
    """The recording with other messages of a kind, and with what the robot claims."""
    config = recording.config
    assert config is not None
    samples = []
    for topic in ("controller/state", "camera/depth", "heightmap/heightmap"):
        for index, (arrival_ns, envelope, payload) in enumerate(recording.payloads(topic)):
            message: Message | None = codec.decode_message(TOPICS[topic].message, payload)
            if isinstance(message, kind):
                message = change(message, index)
            if message is not None:
                again = Envelope(envelope.sequence, message.time_ns, envelope.boot_id)
                samples.append(
                    RawSample(topic, codec.encode_message(message), again.to_bytes(), arrival_ns)
                )
    samples.sort(key=lambda sample: sample.arrival_ns)
    with Recorder(
        path, config, setup_of(recording.terrain, robot=robot or recording.robot)
    ) as file:
        for sample in samples:
            file.write(sample)
    return read_recording(path)


def bad(recording: Recording) -> list[str]:
    return [finding.name for finding in check_standing(recording) if not finding.good]


def same(message: Message, _: int) -> Message:
    return message


def half_of_them(message: Message, index: int) -> Message | None:
    return message if index % 2 else None


def dated_at_arrival(message: Any, _: int) -> Message:
    return replace(message, time_ns=message.time_ns + 55 * MS)


def dated_long_ago(message: Any, _: int) -> Message:
    return replace(message, time_ns=max(0, message.time_ns - 80 * MS))


def degraded(message: Any, _: int) -> Message:
    return replace(message, status=HeightmapStatus.DEGRADED)


def higher(message: Any, _: int) -> Message:
    return replace(message, height=message.height + 0.02)


def unsure(message: Any, _: int) -> Message:
    return replace(message, half_width_90=np.full(30, 0.1))


def told_by_ros(message: Any, _: int) -> Message:
    """Nobody says which feet stand, nor in which mode the robot is."""
    return replace(message, leg_trusted=np.zeros(4, np.bool_), mode=ControllerMode.RUN)


FAULTS: dict[str, tuple[type[Message], Change, list[str]]] = {
    "none": (Heightmap, same, []),
    "none, and feet that nobody knows of": (RobotState, told_by_ros, []),
    "half of the images": (DepthFrame, half_of_them, ["images"]),
    "half of the states": (RobotState, half_of_them, ["states"]),
    "dated at arrival": (DepthFrame, dated_at_arrival, ["age of images"]),
    "late": (DepthFrame, dated_long_ago, ["age of images"]),
    "degraded": (Heightmap, degraded, ["status"]),
    "2 cm too high": (Heightmap, higher, ["heights"]),
    "unsure": (Heightmap, unsure, ["half of the 90 % interval"]),
}


@pytest.mark.sample(5)
@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_wrong_is_named_and_nothing_else(
    standing: Recording, tmp_path: Path, fault: str
) -> None:
    kind, change, names = FAULTS[fault]
    assert bad(changed(standing, tmp_path / "changed.mcap", kind, change, None)) == names


@pytest.mark.sample(2)
@pytest.mark.parametrize("off", [{"pitch": 0.04}, {"pitch": -0.04}, {"z": 0.02}, {"z": -0.02}])
def test_a_camera_that_sits_elsewhere_than_claimed_is_named(
    standing: Recording, tmp_path: Path, off: dict[str, float]
) -> None:
    robot = standing.robot
    place = robot.camera_position + np.array([0.0, 0.0, off.get("z", 0.0)])
    claims = replace(
        robot, camera_pitch=robot.camera_pitch + off.get("pitch", 0.0), camera_position=place
    )
    assert bad(changed(standing, tmp_path / "changed.mcap", Heightmap, same, claims)) == [PLACE]


def test_the_command_ends_as_its_verdict_says(
    standing: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["heightmap", "check", str(standing.path), "--json"]) == 0
    *_, verdict, table = capsys.readouterr().out.splitlines()
    assert verdict == "these heights can be trusted"
    assert json.loads(table)["trusted"]
    high = changed(standing, tmp_path / "high.mcap", Heightmap, higher, None).path
    assert main(["heightmap", "check", str(high)]) == 1
    assert capsys.readouterr().out.splitlines()[-1] == "do not trust these heights: heights"


@pytest.mark.parametrize("missing", ["camera/depth", "controller/state", "heightmap/heightmap"])
def test_what_is_not_there_is_said_in_one_line(
    standing: Recording, tmp_path: Path, missing: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = changed(
        standing, tmp_path / "some.mcap", TOPICS[missing].message, lambda *_: None, None
    ).path
    assert main(["heightmap", "check", str(path)]) == 2
    assert f"no messages of {missing}" in capsys.readouterr().err


@pytest.mark.parametrize("ahead_s", [-1e5, -1.0, 1.0, 1e5])
def test_a_clock_of_its_own_is_named_for_which_no_service_answers(
    standing: Recording, tmp_path: Path, ahead_s: float, capsys: pytest.CaptureFixture[str]
) -> None:
    path, begin_ns = tmp_path / "own.mcap", 10**15
    config = replace(
        standing.config or RunConfig(robot="go1", grid="line"), pace="realtime", epoch_ns=1
    )
    with Recorder(path, config, setup_of(standing.terrain, robot=standing.robot)) as file:
        for topic in ("controller/state", "camera/depth"):
            for arrival_ns, envelope, payload in standing.payloads(topic):
                dated_ns = envelope.capture_ns + begin_ns + round(1e9 * ahead_s)
                message = replace(
                    codec.decode_message(TOPICS[topic].message, payload), time_ns=dated_ns
                )
                again = Envelope(envelope.sequence, dated_ns, envelope.boot_id).to_bytes()
                file.write(
                    RawSample(topic, codec.encode_message(message), again, arrival_ns + begin_ns)
                )
    assert main(["heightmap", "check", str(path)]) == 2
    said = f"states are {abs(ahead_s):.3f} s {'ahead of' if ahead_s > 0 else 'behind'} the clock of this computer"
    assert said in capsys.readouterr().err


def test_it_needs_one_thing_to_look_at(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["heightmap", "check"]) == 2
    assert main(["heightmap", "check", str(tmp_path), "--run-dir", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("needs a recording, or --run-dir") == 2


@pytest.mark.parametrize(("off_m", "named"), [(0.0, []), (0.04, ["heights"])])
def test_a_scan_is_judged_where_it_was_seen(
    standing: Recording, tmp_path: Path, off_m: float, named: list[str]
) -> None:
    """Points that no image has shown may be anywhere."""
    level_m = standing.of(RobotState)[0].base_height

    def scanned(message: Any, index: int) -> Message | None:
        heights = np.full(187, off_m - level_m)
        ages = np.full(187, 0.06)
        ages[100:], heights[100:] = np.inf, 5.0
        return replace(
            message, x=np.array(SCAN.x), y=np.array(SCAN.y), height=heights,
            half_width_90=np.full(187, 0.02),
            age_s=ages, seen_share=100 / 187,
        )  # fmt: skip

    assert bad(changed(standing, tmp_path / "scan.mcap", Heightmap, scanned, None)) == named
