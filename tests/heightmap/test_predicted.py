"""Predicted heights in roll-outs: to each robot what camera process
and heightmap service would give it.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pytest
from memory_bus import MemoryBus, MemoryHub
from samples import PROFILE, ROBOT, put_run, setups_of
from test_camera_family import CASES, with_latency

from saltus import used_networks
from saltus.config import RunConfig, TerrainConfig
from saltus.depth_camera import load_camera
from saltus.effects.effect import Effect
from saltus.effects.image_delivery import FrameDrop
from saltus.effects.profile import load_profile
from saltus.errors import ModelError
from saltus.grid import LINE
from saltus.heightmap.data.predicted import PredictedHeightsFactory, load_predictor
from saltus.heightmap.scan.predictor import ScanNetwork
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.scan import ScanService
from saltus.heightmap.service.scan_fleet import ScanChoice
from saltus.heightmap.service.service import HeightmapService
from saltus.loop.heights import HeightSource
from saltus.loop.loop import Loop, Moment
from saltus.policy.evaluation.evaluate import EvaluationSettings, run_batch
from saltus.policy.planner import make_planner
from saltus.render.__main__ import build
from saltus.render.process import CameraProcess
from saltus.runtime.process import ProcessContext
from saltus.states import robot_state_message
from saltus.terrain.curriculum import make_terrain
from saltus.trial import Trial
from saltus.wire.messages import ControllerMode, DepthFrame, GroundTruth, Heightmap, RobotState

TRIALS = [Trial.draw(seed) for seed in (3, 4, 5)]
KINDS = ("stairs", "stairs", "gap")
TERRAINS = [make_terrain(TerrainConfig(terrain=kind)) for kind in KINDS]
SCAN = used_networks.model_path("scan")
TICKS = 40
TICK_NS = 10_000_000
GAPS = (FrameDrop(fraction=0.8),)
"""After long ones the service forgets."""


def robot_state(step: Moment, robot: int) -> RobotState:
    states = step.states
    return robot_state_message(
        states, robot, time_ns=states.step * TICK_NS, step=states.step, mode=ControllerMode.RUN
    )


def ground_truth(step: Moment, robot: int) -> GroundTruth:
    return GroundTruth(
        time_ns=step.states.step * TICK_NS,
        step=step.states.step,
        position_base_in_world=step.truth.position_base_in_world[robot],
        quaternion_base_in_world=step.truth.quaternion_base_in_world[robot],
        velocity_base_in_world=step.truth.velocity_base_in_world[robot],
        angular_velocity_base=step.truth.angular_velocity_base[robot],
        joint_position=step.truth.joint_position[robot],
        foot_force=step.truth.foot_force[robot],
        x=np.array(LINE.x),
        height=np.zeros(30),
    )


def rollout(model: Path, profile: str = "shipped", stand_steps: int = 60) -> Loop:
    planner, setups = (
        make_planner("scripted", ROBOT, LINE),
        setups_of(TERRAINS, TRIALS, load_profile(profile, ROBOT)),
    )
    heights = PredictedHeightsFactory(model=model)(setups)
    return Loop(setups, planner, heights=heights, stand_steps=stand_steps)


def deployed(profile: str, folder: Path) -> list[CameraProcess]:
    """The camera processes of these trials."""
    processes = []
    for trial, kind in zip(TRIALS, KINDS, strict=True):
        config = RunConfig(
            robot="go1",
            grid="line",
            seed=trial.seed,
            terrain=TerrainConfig(terrain=kind),
            camera="ideal",
            renderer="embree",
            profile=profile,
        )
        bus = MemoryBus("robot/0", MemoryHub())
        processes.append(build(ProcessContext("render", config, put_run(folder, config), bus)))
    return processes


class Service(Protocol):
    """Answers a state, with the image that has arrived."""

    def step(self, state: RobotState, frame: DepthFrame | None, now_ns: int, /) -> Heightmap: ...


def compare(
    effects: tuple[Effect[Any], ...], model: Path, services: Sequence[Service], folder: Path
) -> None:
    """Steps a batch and the deployed processes of each of its robots,
    and holds their heights to each other.
    """
    path = folder / "profile.toml"
    path.write_text(with_latency(effects).to_toml(), encoding="utf-8")
    batch, cameras = rollout(model, str(path), stand_steps=20), deployed(str(path), folder)
    for k in range(TICKS):
        step = batch.step()
        for robot, (camera, service) in enumerate(zip(cameras, services, strict=True)):
            frame = camera.step(ground_truth(step, robot), k * TICK_NS)
            answer = service.step(robot_state(step, robot), frame, k * TICK_NS)
            np.testing.assert_allclose(step.heights[robot], answer.height, atol=1e-5)


@pytest.mark.sample(3)
@pytest.mark.parametrize(
    "effects", [PROFILE.camera, *CASES, GAPS], ids=lambda effects: effects[-1].name
)
def test_they_are_those_of_the_deployed_processes(
    effects: tuple[Effect[Any], ...], model_path: Path, tmp_path: Path
) -> None:
    network = HeightmapNetwork(ROBOT, model_path)
    compare(effects, model_path, [HeightmapService(network) for _ in TRIALS], tmp_path)


@pytest.mark.sample(1)
@pytest.mark.parametrize("effects", [PROFILE.camera, GAPS], ids=["shipped", "gaps"])
def test_those_of_the_scan_are_those_of_its_services(
    effects: tuple[Effect[Any], ...], tmp_path: Path
) -> None:
    choice = ScanChoice.of_run(LINE, str(SCAN), "learned")
    assert choice is not None
    rig, network = choice.rig(ROBOT, load_camera("ideal")), ScanNetwork(SCAN)
    compare(effects, SCAN, [ScanService(network, rig) for _ in TRIALS], tmp_path)


def test_a_file_says_whether_it_is_of_the_line_or_of_the_scan(model_path: Path) -> None:
    assert isinstance(load_predictor(model_path, ROBOT), HeightmapNetwork)
    assert isinstance(load_predictor(SCAN, ROBOT), ScanNetwork)
    with pytest.raises(ModelError, match="policy"):
        load_predictor(used_networks.model_path("policy"), ROBOT)


@pytest.mark.sample(1)
@pytest.mark.parametrize("kind", ["line", "scan"])
def test_a_robot_that_starts_again_has_forgotten(kind: str, model_path: Path) -> None:
    batch = rollout(model_path)
    model = model_path if kind == "line" else SCAN
    source: HeightSource = PredictedHeightsFactory(model=model)(setups_of(TERRAINS, TRIALS))
    steps = [batch.step() for _ in range(40)]
    everyone, nobody = np.ones(3, dtype=np.bool_), np.zeros(3, dtype=np.bool_)
    first = [
        source.heights(s.states, s.truth, everyone if i == 0 else nobody)
        for i, s in enumerate(steps)
    ]
    again = [
        source.heights(s.states, s.truth, everyone if i == 0 else nobody)
        for i, s in enumerate(steps)
    ]
    np.testing.assert_array_equal(first, again)


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("camera", "course", "model"),
    [
        ("ideal", {"terrain": "stairs"}, None),
        ("d435i", {"terrain": "stepping_stones", "gap_max_m": 0.5}, None),
        ("d435i", {"terrain": "gap"}, SCAN),
    ],
    ids=["ideal", "d435i", "scan"],
)
def test_a_trial_does_not_depend_on_who_else_is_in_the_batch(
    camera: str, course: dict[str, Any], model: Path | None
) -> None:
    evaluation = EvaluationSettings(
        robot="go1", grid="line", camera=camera, course=TerrainConfig(**course), time_limit_s=1.0
    )
    run = partial(
        run_batch,
        evaluation,
        PredictedHeightsFactory(model=model),
        partial(make_planner, "learned"),
    )
    alone, together = run([4])[4], run([3, 4, 5])[4]
    assert alone.outcome == together.outcome
    for name, values in vars(alone.trace).items():
        np.testing.assert_array_equal(values, vars(together.trace)[name])
