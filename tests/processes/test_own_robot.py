"""A robot without Saltus joins `saltus router`, and reads from the bus what Saltus reads."""

import contextlib
import json
import runpy
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from saltus.cli.main import main
from saltus.dialects import DIALECTS
from saltus.grid import SCAN
from saltus.robots.loading import load_robot
from saltus.runtime.run_folder import CLIENT_FILE, endpoint_of, read_run
from saltus.wire import schemas
from saltus.wire.messages import Heightmap, HeightmapStatus
from saltus.wire.zenoh_bus import ZenohBus

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_robot.py"
SALTUS = [sys.executable, "-P", "-m", "saltus.cli.main"]
PATIENCE_S = 60.0


@contextlib.contextmanager
def running(*command: str) -> Iterator[subprocess.Popen[str]]:
    """A command that is ended as a service manager ends it."""
    with subprocess.Popen([*SALTUS, *command], stdout=subprocess.PIPE, text=True) as process:
        yield process
        process.terminate()
        assert process.wait(PATIENCE_S) == -signal.SIGTERM


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder of a router with a heightmap service."""
    folder = tmp_path_factory.mktemp("run")
    with running("router", "--out", str(folder)) as router:
        assert router.stdout is not None
        assert router.stdout.readline().startswith("router at")
        with ZenohBus(endpoint_of(folder), "robot/0") as bus:
            status = bus.latest("status", "heightmap")
            with running("heightmap", "serve", "--run-dir", str(folder)):
                assert status.wait(PATIENCE_S) is not None
                yield folder


def test_a_robot_without_saltus_is_told_what_saltus_is_told(run_dir: Path) -> None:
    built_in: dict[int, Heightmap] = {}
    told = run_dir / "told.jsonl"
    command = [
        sys.executable,
        "-I",
        str(EXAMPLE),
        str(run_dir / CLIENT_FILE),
        "--seconds",
        "3",
        "--json",
    ]
    with ZenohBus(endpoint_of(run_dir), "robot/0") as bus, told.open("w") as file:
        heightmaps = bus.latest("heightmap/heightmap")
        with subprocess.Popen(command, stdout=file) as robot:
            while robot.poll() is None:
                sample = heightmaps.wait(0.01)
                if sample is not None:
                    built_in[sample.message.step] = sample.message
        assert robot.returncode == 0
    own = {row["step"]: row for row in map(json.loads, told.read_text().splitlines())}
    both = own.keys() & built_in.keys()
    assert len(both) > 20
    for step in both:
        for name in ("x", "height", "half_width_90"):
            np.testing.assert_allclose(
                own[step][name], getattr(built_in[step], name), rtol=0.0, atol=1e-6
            )
        assert own[step]["status"] == built_in[step].status
    seen = [row for row in own.values() if row["status"] == HeightmapStatus.OK]
    assert seen
    ahead = np.array(seen[-1]["x"]) > 0.5
    # Level ground below the feet
    np.testing.assert_allclose(np.array(seen[-1]["height"])[ahead], -0.285, atol=0.01)


@pytest.mark.slow
def test_a_robot_that_stands_is_checked_while_it_runs(
    run_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """How often and how late its messages come is up to this computer; the rest is good."""
    robot = subprocess.Popen(
        [sys.executable, "-I", str(EXAMPLE), str(run_dir / CLIENT_FILE), "--seconds", "60"]
    )
    with ZenohBus(endpoint_of(run_dir), "robot/0") as bus:
        assert bus.latest("heightmap/heightmap").wait(PATIENCE_S) is not None
    assert main(["heightmap", "check", "--run-dir", str(run_dir), "--seconds", "2", "--json"]) in (
        0,
        1,
    )
    robot.kill()
    robot.wait()
    begun, *_, table = capsys.readouterr().out.splitlines()
    assert begun == "listening for 2 s"
    good = {finding["name"]: finding["good"] for finding in json.loads(table)["findings"]}
    assert good["the camera's place"]
    assert good["heights"]


def test_the_example_has_todays_messages() -> None:
    definitions = runpy.run_path(str(EXAMPLE))["DEFINITIONS"]
    assert definitions == {name: schemas.DEFINITIONS[name] for name in definitions}


def test_a_router_says_what_runs(run_dir: Path) -> None:
    run = read_run(run_dir)
    assert run.setup.robot == load_robot(run.config.robot)
    assert run.config.pace == "realtime"
    assert (run_dir / CLIENT_FILE).stat().st_mode & 0o777 == 0o600
    before_ns = time.monotonic_ns()
    with ZenohBus(endpoint_of(run_dir), run.config.prefix) as bus:
        sample = bus.latest("status", "heightmap").wait(PATIENCE_S)
    assert sample is not None
    assert sample.message.time_ns >= before_ns - 10**9  # the run's clock is that of the machine


def test_any_robot_without_saltus_is_told_187_heights_and_its_policys_observation(
    tmp_path: Path,
) -> None:
    """Images are looked at even where this computer is too slow for them to come in time."""
    examples = EXAMPLE.parent
    camera = ("--camera", str(examples / "scan_camera.toml"))
    with running("router", "--grid", "scan", *camera, "--out", str(tmp_path)) as router:
        assert router.stdout is not None
        assert router.stdout.readline().startswith("router at")
        with ZenohBus(endpoint_of(tmp_path), "robot/0") as bus:
            status, heights = bus.latest("status", "heightmap"), bus.latest("heightmap/heightmap")
            flags = ("--dialect", "isaaclab", "--body", "none")
            with running("heightmap", "serve", "--run-dir", str(tmp_path), *flags):
                assert status.wait(PATIENCE_S) is not None
                command = [
                    sys.executable,
                    str(examples / "scan_robot.py"),
                    str(tmp_path / CLIENT_FILE),
                ]
                with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as robot:
                    assert robot.stdout is not None
                    assert ": 187 heights, " in robot.stdout.readline()
                    until_s = time.monotonic() + PATIENCE_S
                    told: Heightmap | None = None
                    while time.monotonic() < until_s and (told is None or told.seen_share < 0.3):
                        sample = heights.wait(PATIENCE_S)
                        told = None if sample is None else sample.message
                    robot.terminate()
    assert told is not None
    assert told.seen_share >= 0.3
    seen = np.isfinite(told.age_s)
    np.testing.assert_allclose(told.height[seen], -0.4, atol=0.03)
    np.testing.assert_allclose(
        told.observation, DIALECTS["isaaclab"].observation(told.height, SCAN), atol=1e-9
    )
