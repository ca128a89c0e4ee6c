"""One heightmap process serves several robots.

One falls silent, bad and good models are given to it while it runs.
"""

import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from samples import ROBOT, put_run

from saltus.clock import RunClock
from saltus.config import RunConfig, to_toml
from saltus.depth import MILLIMETRE, MODEL_CAMERA
from saltus.heightmap.level_robot import LevelRobot
from saltus.heightmap.service.model_inbox import FILE, give_model
from saltus.model_file import ModelFile, put_model
from saltus.resources import shipped_file
from saltus.runtime.run_folder import RUN_FILE
from saltus.runtime.ticker import Ticker
from saltus.wire.messages import DepthFrame, HeightmapStatus
from saltus.wire.router import open_router
from saltus.wire.zenoh_bus import ZenohBus

ROBOTS = ("fleet/0", "fleet/1", "fleet/2")
READY_S = 60.0
PATIENCE_S = 30.0


class Robot:
    """Sends a state every 10 ms and an image every 20 ms, 50 ms old; keeps what it is answered."""

    def __init__(self, endpoint: str, prefix: str, clock: RunClock) -> None:
        self.bus = ZenohBus(endpoint, prefix)
        self.answered: Counter[tuple[str, HeightmapStatus]] = Counter()
        self.events: list[str] = []
        self.refused = 0
        self.clock, self._step = clock, 0
        self._states, self._frames = (
            self.bus.publisher("controller/state"),
            self.bus.publisher("camera/depth"),
        )
        self._heightmaps = self.bus.latest("heightmap/heightmap")
        self._status, self._event = (
            self.bus.latest("status", "heightmap"),
            self.bus.latest("event", "heightmap"),
        )
        self._rng = np.random.default_rng(0)

    def step(self) -> None:
        frame = DepthFrame(
            time_ns=self.clock.now_ns() - 50_000_000,
            frame_id=self._step // 2,
            depth=self._rng.integers(300, 2500, (MODEL_CAMERA.height, MODEL_CAMERA.width)).astype(
                np.uint16
            ),
            depth_unit_m=MILLIMETRE,
            fx=MODEL_CAMERA.fx,
            fy=MODEL_CAMERA.fy,
            cx=MODEL_CAMERA.cx,
            cy=MODEL_CAMERA.cy,
        )
        if self._step % 2 == 0:
            self._frames.put(frame)
        self._states.put(replace(LevelRobot().states(ROBOT, [frame])[0], step=self._step))
        self._step += 1
        self.listen()

    def listen(self) -> None:
        heightmap, status, event = self._heightmaps.take(), self._status.take(), self._event.take()
        if heightmap is not None:
            self.answered[
                heightmap.message.model_id, HeightmapStatus(heightmap.message.status)
            ] += 1
        if status is not None:
            self.refused = status.message.rejected.get("model/refused", 0)
        if event is not None:
            self.events.append(event.message.code)


@pytest.fixture
def robots(speed: float, tmp_path: Path) -> Iterator[list[Robot]]:
    endpoint, router = open_router()
    began_ns = time.monotonic_ns() - round(1e9 / speed)
    config = RunConfig(
        robot="go1",
        grid="line",
        pace="realtime",
        epoch_ns=began_ns,
        time_limit_s=600.0,
        speed=speed,
    )
    (put_run(tmp_path, config) / RUN_FILE).write_text(to_toml(config))
    clock = RunClock.of(config)
    robots = [Robot(endpoint, prefix, clock) for prefix in ROBOTS]
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "saltus.heightmap",
            "--run-dir",
            str(tmp_path),
            "--endpoint",
            endpoint,
            "--robots",
            *ROBOTS,
        ],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    deadline_s = time.monotonic() + clock.machine_s(READY_S)
    while robots[0]._status.wait(0.1) is None:
        assert process.poll() is None, "the service has died"
        assert time.monotonic() < deadline_s
    yield robots
    process.terminate()
    assert process.wait(clock.machine_s(PATIENCE_S)) == 0
    for robot in robots:
        robot.bus.close()
    router.close()


def run_until(robots: list[Robot], event: str, models: set[str]) -> None:
    """Robots send until the first of them is told of an event,
    and each has been answered by exactly these models.
    """
    clock = robots[0].clock
    ticker, deadline_s = Ticker(100.0, clock=clock), clock.elapsed_s() + PATIENCE_S
    while event not in robots[0].events or any(
        {model for model, _ in each.answered} != models for each in robots
    ):
        told = [(robot.events, robot.answered) for robot in robots]
        assert clock.elapsed_s() < deadline_s, f"no {event} or not by {models}: {told}"
        ticker.wait()
        for robot in robots:
            robot.step()


def another_model(folder: Path) -> Path:
    """The shipped model with a remark, which makes it another file."""
    model = onnx.load(shipped_file("models/heightmap.onnx"))
    model.metadata_props.add(key="remark", value="another")
    partial, path = folder / ".partial", folder / "another.onnx"
    onnx.save(model, partial)
    put_model(partial, path)
    return path


def test_a_fleet_is_served_whoever_is_silent_and_whatever_model_is_given(
    robots: list[Robot], tmp_path: Path
) -> None:
    shipped = ModelFile(shipped_file("models/heightmap.onnx")).model_id
    run_until(robots, "heightmap_ok", {shipped})
    active, silent = robots[:2], robots[2]
    silent.listen()
    before = silent.answered.total()

    bad = tmp_path / ".bad"
    bad.write_bytes(shipped_file("models/heightmap.onnx").read_bytes()[:-4096])
    put_model(bad, tmp_path / FILE)
    run_until(active, "model_refused", {shipped})

    model_id = give_model(another_model(tmp_path), tmp_path)
    for robot in active:
        robot.answered.clear()
    run_until(active, "model_swapped", {shipped, model_id})
    for robot in active:
        assert not any(status == HeightmapStatus.WARMING for _, status in robot.answered)
        assert robot.refused == 1
    silent.listen()
    assert silent.answered.total() <= before + 1
