"""A recorded run tells its ground again: in figures, and on the bus."""

import contextlib
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from walked_stairs import carried

from saltus.cli.main import main
from saltus.config import RunConfig, TerrainConfig
from saltus.grid import SCAN
from saltus.named_setup import named_setup
from saltus.recordings.recorder import Recorder
from saltus.wire import codec
from saltus.wire.bus import RawSample
from saltus.wire.codec import Envelope
from saltus.wire.messages import DepthFrame, GroundTruth, Message
from saltus.wire.router import open_router
from saltus.wire.zenoh_bus import ZenohBus

STEPS = 170
PATIENCE_S = 60.0


def rolled(frame: DepthFrame) -> DepthFrame:
    """The image that a camera in the same place would take, rolled by 180 degrees."""
    height, width = frame.depth.shape
    turned = np.ascontiguousarray(frame.depth[::-1, ::-1])
    return replace(frame, depth=turned, cx=width - frame.cx, cy=height - frame.cy)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run") / "recording.mcap"
    config = RunConfig(
        robot="go1", grid="line", terrain=TerrainConfig(terrain="stairs", difficulty=0.2)
    )
    setup = named_setup(config)
    counts: dict[str, int] = {}
    with Recorder(path, config, setup) as file:

        def write(key: str, message: Message, arrival_ns: int) -> None:
            counts[key] = counts.get(key, 0) + 1
            envelope = Envelope(counts[key], message.time_ns, b"of one simulator")
            file.write(
                RawSample(key, codec.encode_message(message), envelope.to_bytes(), arrival_ns)
            )

        for tick in carried(setup, SCAN, STEPS):
            now_ns = tick.state.time_ns
            if tick.frame is not None:
                write("camera/depth", tick.frame, now_ns)
                write("camera/depth/rolled", rolled(tick.frame), now_ns)
            truth = GroundTruth(
                time_ns=now_ns, step=tick.state.step, position_base_in_world=tick.position,
                quaternion_base_in_world=tick.state.quaternion_base_in_world,
                velocity_base_in_world=np.zeros(3),
                angular_velocity_base=np.zeros(3), joint_position=tick.state.joint_position,
                foot_force=np.zeros(4),
                x=np.zeros(1), height=np.zeros(1),
            )  # fmt: skip
            write("plant/truth", truth, now_ns)
            write("controller/state", tick.state, now_ns)
    return path


def test_figures_and_the_picture_are_those_of_the_ground_of_the_run(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = tmp_path / "scan.png"
    assert (
        main(["replay", str(recording), "--grid", "scan", "--picture", str(picture), "--json"]) == 0
    )
    image = cv2.imread(str(picture))
    assert image is not None
    width = image.shape[1]
    heights, truth = image[64:-40, : width // 4], image[64:-40, width // 4 : width // 2]
    assert np.abs(heights.astype(float) - truth).mean() < 15.0  # of 255: they look alike
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert found["points"] == SCAN.size
    assert sum(found["status"].values()) == STEPS
    assert found["seen"]["mean_mm"] < 17.0  # docs/scan.md
    assert found["seen"]["share"] + found["never"]["share"] == pytest.approx(1.0, abs=2e-3)
    assert found["visible"]["share"] + found["remembered"]["share"] == pytest.approx(
        found["seen"]["share"], abs=2e-3
    )


def test_a_run_in_which_nobody_told_heights_has_nothing_to_compare(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(recording), "--json"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert sum(found["status"].values()) == STEPS
    assert "messages" not in found


def test_images_of_further_cameras_are_read_with_their_own_mounts(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same view rolled, with its roll said, tells the same ground;
    with none said, it misleads.
    """

    def seen_mm(*rolls_rad: float) -> float:
        files = []
        for name, roll_rad in zip(("first", "rolled"), (0.0, *rolls_rad), strict=False):
            files.append(tmp_path / f"{name}.toml")
            files[-1].write_text(f'name = "{name}"\ncamera_roll = {roll_rad}\n')
        cameras = ["--cameras", *map(str, files)]
        assert main(["replay", str(recording), "--grid", "scan", *cameras, "--json"]) == 0
        return float(json.loads(capsys.readouterr().out.splitlines()[-1])["seen"]["mean_mm"])

    alone, both, misled = seen_mm(), seen_mm(np.pi), seen_mm(0.0)
    assert both == pytest.approx(alone, abs=3.0)
    assert misled > 3.0 * alone
    other = tmp_path / "other.toml"
    other.write_text('name = "rear"\n')
    first = str(tmp_path / "first.toml")
    assert main(["replay", str(recording), "--grid", "scan", "--cameras", first, str(other)]) == 2
    assert "has no camera/depth/rear" in capsys.readouterr().err


def test_it_is_served_with_states_and_images(recording: Path) -> None:
    endpoint, router = open_router()
    command = [
        "heightmap",
        "serve",
        "--recording",
        str(recording),
        "--grid",
        "scan",
        "--dialect",
        "mjlab",
    ]
    with contextlib.closing(router), ZenohBus(endpoint, "robot/0") as bus:
        heights, states = bus.latest("heightmap/heightmap"), bus.latest("controller/state")
        with subprocess.Popen(
            [sys.executable, "-m", "saltus.cli.main", *command, "--endpoint", endpoint]
        ) as serve:
            sample = heights.wait(PATIENCE_S)
            assert sample is not None
            assert sample.message.dialect == "mjlab"
            assert len(sample.message.observation) == SCAN.size
            assert states.wait(PATIENCE_S) is not None
            serve.kill()


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--grid", "scam"], "scan"),
        (["--grid", "scan", "--dialect", "isaaclap"], "isaaclab"),
        (["--dialect", "isaaclab"], "--grid scan"),
        (["--grid", "scan", "--body", "big"], "0.6x0.4x0.5"),
    ],
)
def test_what_does_not_fit_is_said_in_one_line(
    recording: Path, flags: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(recording), *flags]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
