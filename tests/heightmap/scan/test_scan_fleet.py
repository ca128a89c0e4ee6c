"""Robots with several cameras, on the bus: each image comes under its camera's name,
and a restart empties one map.
"""

from pathlib import Path

import numpy as np
import pytest
from memory_bus import MemoryBus, MemoryHub
from plane_world import BEGIN_NS, LATENCY_NS, STEP_NS, PlaneWorld, map_network
from samples import ROBOT, put_run

from saltus.config import RunConfig, RunPlanner
from saltus.depth_camera import DepthCamera, load_camera
from saltus.errors import ConfigError
from saltus.grid import SCAN
from saltus.heightmap.service.robot_inbox import RobotInbox
from saltus.heightmap.service.scan_fleet import ScanChoice, ScanFleet
from saltus.robots.mount import Mount
from saltus.runtime.process import ProcessContext
from saltus.wire.topics import TOPICS

WORLD, PREFIX = PlaneWorld(), "robot/0"


def camera(name: str, yaw: float) -> DepthCamera:
    return DepthCamera(
        name=name, camera_position=(0.25 * float(np.cos(yaw)), 0.0, 0.1), camera_pitch=0.8,
        camera_roll=0.0,
        camera_yaw=yaw, image=load_camera("ideal").image,
    )  # fmt: skip


def choice(path: Path, *cameras: DepthCamera, body: str = "none") -> ScanChoice:
    return ScanChoice(grid=SCAN, cameras=cameras, body=body, model=map_network(path / "map.onnx"))


def test_images_of_two_cameras_come_under_their_names_and_a_robot_that_starts_anew_has_seen_nothing(
    tmp_path: Path,
) -> None:
    config, hub = RunConfig(robot="go1", grid="scan", pace="lockstep"), MemoryHub()
    context = ProcessContext("heightmap", config, put_run(tmp_path, config), MemoryBus(PREFIX, hub))
    front, rear = camera("front", 0.0), camera("rear", np.pi)
    asked = choice(tmp_path, front, rear)
    fleet = ScanFleet(asked.network(), asked.rig(ROBOT, front), [PREFIX], at_once=True)
    link = RobotInbox(context, TOPICS["camera/depth"], ["rear"])
    mounts = {"": Mount.of(front.mounted_on(ROBOT)), "rear": Mount.of(rear.mounted_on(ROBOT))}

    def run(robot: MemoryBus, first: int, steps: int) -> float:
        states = robot.publisher("controller/state")
        frames = {name: robot.publisher("camera/depth", name) for name in mounts}
        for step in range(first, first + steps):
            due = step // 2 - 3 if first + 6 <= step else -1
            if step % 2 == 0 and due >= 0:
                time_ns = BEGIN_NS + step * STEP_NS - LATENCY_NS
                for name, mount in mounts.items():
                    frames[name].put(WORLD.frame(mount, time_ns, due))
            states.put(WORLD.state(step, ROBOT, depth_due=due))
            request = link.take()
            assert request is not None
            assert [name for name, _, _ in request.images] == (
                ["", "rear"] if step % 2 == 0 and due >= 0 else []
            )
            answer = fleet.step({PREFIX: request})[PREFIX]
        return answer.seen_share

    both = run(MemoryBus(PREFIX, hub), 0, 16)
    assert both > 0.3
    assert run(MemoryBus(PREFIX, hub), 16, 3) == 0.0
    fleet.close()


@pytest.mark.parametrize(
    "names", [("front", "front", "rear"), ("a", "b/c"), ("front", "rear", "rear")]
)
def test_cameras_need_names_of_their_own(tmp_path: Path, names: tuple[str, ...]) -> None:
    cameras = [camera(name, 0.0) for name in names]
    if len(set(names[1:])) == len(names[1:]) and not any("/" in name for name in names):
        assert set(choice(tmp_path, *cameras).rig(ROBOT, cameras[0]).cameras) == {"", *names[1:]}
    else:
        with pytest.raises(ConfigError, match="names of cameras"):
            choice(tmp_path, *cameras).rig(ROBOT, cameras[0])


@pytest.mark.parametrize("planner", ["scripted", "learned", "walking"])
def test_a_run_that_jumps_is_told_of_shadows(tmp_path: Path, planner: RunPlanner) -> None:
    asked = ScanChoice.of_run(SCAN, str(map_network(tmp_path / "map.onnx")), planner)
    assert asked is not None
    assert asked.rig(ROBOT, camera("front", 0.0)).shadows == (planner != "walking")


@pytest.mark.parametrize("body", ["robot", "none", "0.6x0.4x0.5"])
def test_what_a_service_is_not_told_is_said_in_one_line(tmp_path: Path, body: str) -> None:
    asked = choice(tmp_path, body=body)
    asked.rig(ROBOT, camera("front", 0.0))
    line = asked.missing(ROBOT)
    assert "\n" not in line
    assert ("go1" in line) == (body == "robot")
