"""Every effect of a camera in every simulator that has cameras:
robots get the images that the camera process gives.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from samples import EVERYTHING, PROFILE, ROBOT
from synthetic_motion import gliding_robots

from saltus.depth import MODEL_CAMERA
from saltus.depth_camera import SHIPPED
from saltus.effects.camera import CameraChain, ViewChain
from saltus.effects.effect import Effect
from saltus.effects.image_delivery import CameraLatency
from saltus.effects.image_pixels import to_images
from saltus.effects.profile import Profile
from saltus.grid import LINE
from saltus.heightmap.data import device_cameras
from saltus.heightmap.data.delivery import TICK_S, ImageDeliveryModel, draw_delivery
from saltus.heightmap.data.device_cameras import DeviceCameras, late_images
from saltus.heightmap.data.rollouts import RobotTrajectory, film_robots
from saltus.render.camera import RobotCamera
from saltus.render.embree import EmbreeRenderer
from saltus.render.exposure import PerfectExposure
from saltus.render.process import CameraProcess
from saltus.robots.mount import Mount
from saltus.terrain.boxes import Box, Boxes
from saltus.terrain.terrain import Terrain
from saltus.wire.messages import GroundTruth

CAMERA = EVERYTHING.camera
NAMED = {effect.name: effect for effect in CAMERA}
HOLES = NAMED["edge_holes"]
CASES = [
    *((effect,) if effect.name != "hole_fill" else (HOLES, effect) for effect in CAMERA),
    CAMERA,
]
TICKS, IDEAL_CAMERA = 120, SHIPPED["ideal"]
NEVER = -1


@dataclass(frozen=True, kw_only=True)
class Hand:
    """The image in hand at each tick."""

    taken: NDArray[np.int64]
    """Tick at which it was, or `NEVER`, shape (ticks,)."""
    depth: dict[int, Any]
    """Images by that tick [mm], shape (48, 16)."""


@pytest.fixture(scope="module")
def motion() -> RobotTrajectory:
    (trajectory,) = gliding_robots(np.random.default_rng(4), 1, ticks=TICKS, terrains=("flat",))
    floor = Box(low=(-2.0, -2.0, -1.0), high=(9.0, 2.0, 0.0))
    posts = [
        Box(low=(x, y, 0.0), high=(x + 0.1, y + 0.1, 0.15))
        for x in np.arange(0.5, 4.0, 0.4)
        for y in (-0.2, 0.1)
    ]
    return replace(trajectory, terrain=Terrain(kind="posts", boxes=(floor, *posts), finish_x=8.0))


def with_latency(effects: tuple[Effect[Any], ...]) -> Profile:
    """The effects beside the shipped latency, unless they have their own."""
    late = any(isinstance(effect, CameraLatency) for effect in effects)
    return Profile(camera=effects if late else (*effects, *PROFILE.camera))


def of_process(profile: Profile, motion: RobotTrajectory) -> Hand:
    """The camera process of the stack."""
    view = RobotCamera.on(ROBOT).moved(profile.view_chain)
    exposure = PerfectExposure(EmbreeRenderer(motion.terrain, view, threads=1), MODEL_CAMERA)
    chain = to_images(profile, MODEL_CAMERA.fx).camera_chain
    process = CameraProcess(IDEAL_CAMERA, exposure, chain, np.random.default_rng(7))
    taken, depth = np.full(TICKS, NEVER), {}
    for k in range(TICKS):
        process.step(truth_of(motion, k), round(k * 1e9 * TICK_S))
        if process.due is not None:
            taken[k] = round(process.due.time_ns / 1e9 / TICK_S)
            depth[taken[k]] = process.due.depth
    return Hand(taken=taken, depth=depth)


def truth_of(motion: RobotTrajectory, k: int) -> GroundTruth:
    return GroundTruth(
        time_ns=round(k * 1e9 * TICK_S),
        step=k,
        position_base_in_world=motion.position_base_in_world[k],
        quaternion_base_in_world=motion.quaternion_base_in_world[k],
        velocity_base_in_world=np.zeros(3),
        angular_velocity_base=np.zeros(3),
        joint_position=motion.joint_position[k],
        foot_force=np.zeros(4),
        x=np.array(LINE.x),
        height=np.zeros(30),
    )


def of_dataset(profile: Profile, motion: RobotTrajectory) -> Hand:
    """An episode as processors collect it, as a training delivers it."""
    view = RobotCamera.on(ROBOT).moved(profile.view_chain)
    (episode,) = film_robots(
        [motion], [view], IDEAL_CAMERA, profile, LINE, np.random.default_rng(7)
    )
    frame = draw_delivery([episode], ImageDeliveryModel(), np.random.default_rng(0)).frame[0]
    taken = np.where(frame >= 0, episode.frame_tick[np.maximum(frame, 0)], NEVER)
    return Hand(
        taken=taken, depth=dict(zip(episode.frame_tick.tolist(), episode.depth, strict=True))
    )


@dataclass(frozen=True)
class OneCourse:
    """One terrain under one robot."""

    motion: RobotTrajectory
    finish_x = np.zeros(1)

    def boxes(self) -> Boxes:
        boxes = self.motion.terrain.arrays
        return Boxes(center=boxes.center[None], half_size=boxes.half_size[None])


def of_device(profile: Profile, motion: RobotTrajectory) -> Hand:
    """Cameras on a device, and what a predictor in the loop has in hand there."""
    course: Any = OneCourse(motion)
    rng = np.random.default_rng(7)
    cameras = DeviceCameras(ROBOT, course, {"ideal": IDEAL_CAMERA}, profile, "cpu", rng)
    images = late_images(
        1, ImageDeliveryModel(), profile.camera_chain.latency, np.random.default_rng(0), "cpu"
    )
    columns = motion.position_base_in_world, motion.quaternion_base_in_world, motion.joint_position
    qpos = torch.tensor(np.concatenate(columns, -1)).float()
    taken, depth = np.full(TICKS, NEVER), {}
    for k in range(TICKS):
        fresh = torch.tensor([k == 0])
        exposed = cameras.expose(course, qpos[k : k + 1], k, fresh)
        new = images.step(exposed.get("ideal"), k * TICK_S, fresh)
        assert bool(new) == bool(
            images.in_hand.time_s > (TICK_S * taken[k - 1] if k and taken[k - 1] >= 0 else -1.0)
        )
        if torch.isfinite(images.in_hand.time_s):
            taken[k] = round(float(images.in_hand.time_s) / TICK_S)
            depth[taken[k]] = images.in_hand.depth[0].numpy()
    return Hand(taken=taken, depth=depth)


def test_there_is_an_example_of_every_effect() -> None:
    assert {type(effect) for effect in CAMERA} == {*ViewChain.order, *CameraChain.order}


@pytest.mark.sample(7)
@pytest.mark.parametrize("effects", CASES, ids=lambda effects: effects[-1].name)
def test_robots_get_the_images_of_the_camera_process(
    effects: tuple[Effect[Any], ...], motion: RobotTrajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    def where_it_should(robot: Any, rng: Any, count: int) -> Mount:
        return Mount(
            position=np.tile(robot.camera_position, (count, 1)),
            pitch=np.full(count, robot.camera_pitch),
        )

    monkeypatch.setattr(device_cameras, "random_mount", where_it_should)
    profile = with_latency(effects)
    plant, without = (of_process(p, motion) for p in (profile, with_latency(effects[:-1])))
    shared = plant.depth.keys() & without.depth.keys()
    changes = not np.array_equal(plant.taken, without.taken)
    assert changes or any((plant.depth[k] != without.depth[k]).any() for k in shared), (
        "the motion shows the effect"
    )
    # rays of Embree and of Warp differ in their last digits: by a millimetre where they are
    # rounded, at edges by more
    for found, room_mm, share in (
        (of_dataset(profile, motion), 0, 0.0),
        (of_device(profile, motion), 1, 0.01),
    ):
        np.testing.assert_array_equal(found.taken, plant.taken)
        off = [found.depth[k].astype(int) - plant.depth[k].astype(int) for k in plant.depth]
        assert (np.abs(off) > room_mm).mean() <= share
