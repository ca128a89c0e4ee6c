"""Robots in simulation are told 187 heights over Zenoh,
by a process that knows none of them by name.
"""

import contextlib
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from samples import ROBOT
from walked_stairs import carried

from saltus.config import RunConfig, TerrainConfig
from saltus.dialects import DIALECTS
from saltus.grid import SCAN
from saltus.named_setup import named_setup
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot
from saltus.robots.shipped import shipped_robots
from saltus.runtime.run_folder import CLIENT_FILE, write_run
from saltus.wire.joining import write_client
from saltus.wire.messages import HeightmapStatus
from saltus.wire.router import open_router
from saltus.wire.zenoh_bus import ZenohBus

PATIENCE_S = 120.0
STEPS, SETTLED = 170, 110
SEEN_M, INSIDE = 0.017, 0.85
"""The network's error on all kinds of ground where seen (docs/scan.md), and somewhat less than its
share inside."""
LONG = replace(
    ROBOT, name="long", thigh_length=0.25, calf_length=0.24, stand_height=0.34, camera_yaw=0.2
)
"""Legs and a camera that no shipped robot has."""


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    "robot", [*(load_robot(name) for name in shipped_robots()), LONG], ids=lambda robot: robot.name
)
def test_a_robot_that_is_carried_up_stairs_is_told_the_ground(robot: Robot, tmp_path: Path) -> None:
    terrain = TerrainConfig(terrain="stairs", difficulty=0.2)
    run = RunConfig(robot="go1", grid="scan", terrain=terrain, pace="lockstep")
    setup = replace(named_setup(run), robot=robot)
    endpoint, router = open_router(speed=run.link_speed)
    with contextlib.closing(router):
        write_run(tmp_path, run, setup)
        write_client(tmp_path / CLIENT_FILE, endpoint)
        command = ["heightmap", "serve", "--run-dir", str(tmp_path), "--dialect", "isaaclab"]
        with (
            ZenohBus.of_run(endpoint, run) as bus,
            subprocess.Popen([sys.executable, "-P", "-m", "saltus.cli.main", *command]) as service,
        ):
            assert bus.latest("status", "heightmap").wait(PATIENCE_S) is not None
            states, frames = bus.publisher("controller/state"), bus.publisher("camera/depth")
            heights, found = bus.latest("heightmap/heightmap"), []
            for tick in carried(setup, SCAN, STEPS):
                if tick.frame is not None:
                    frames.put(tick.frame)
                states.put(tick.state)
                sample = heights.wait(PATIENCE_S)
                assert sample is not None
                assert sample.message.step == tick.state.step
                found.append((sample.message, tick.truth))
            service.terminate()
    settled = found[SETTLED:]
    assert all(answer.status == HeightmapStatus.OK for answer, _ in settled)
    errors, widths, seen = (
        np.array(rows)
        for rows in zip(
            *((np.abs(a.height - t), a.half_width_90, np.isfinite(a.age_s)) for a, t in settled),
            strict=True,
        )
    )
    assert seen.mean() > 0.2
    assert errors[seen].mean() < SEEN_M
    assert (errors <= widths)[seen].mean() > INSIDE
    for answer, _ in settled[::10]:
        assert answer.seen_share == pytest.approx(np.isfinite(answer.age_s).mean())
        expected = DIALECTS["isaaclab"].observation(answer.height, SCAN)
        np.testing.assert_allclose(answer.observation, expected, atol=1e-9)
