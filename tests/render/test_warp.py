from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
import warp
from samples import ROBOT

from saltus.arrays import Floats
from saltus.config import TerrainConfig
from saltus.depth import MODEL_CAMERA, Intrinsics, supersampled_model_camera
from saltus.errors import SaltusError
from saltus.render.camera import RobotCamera
from saltus.render.embree import EmbreeRenderer
from saltus.render.stereo.optics import StereoOptics
from saltus.render.stereo_embree import StereoEmbree
from saltus.render.warp import WarpCaster, WarpRenderer
from saltus.robots.mount import Mount
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.terrain.boxes import Boxes
from saltus.terrain.course_batch import BOXES, DRAWS, draw_courses
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import BOTTOM, Terrain
from saltus.terrain.terrain_stack import TerrainStack

STAIRS = make_terrain(TerrainConfig(terrain="stairs"))


def robots(count: int, terrain: Terrain = STAIRS, seed: int = 0) -> tuple[Floats, Floats, Floats]:
    """Anywhere on the course, legs anywhere."""
    rng = np.random.default_rng(seed)
    position = rng.uniform([0.0, -0.3, 0.3], [terrain.finish_x, 0.3, 0.6], (count, 3))
    position[:, 2] += terrain.height_at(position[:, 0], position[:, 1])
    quaternion = quaternion_from_roll_pitch_yaw(*rng.uniform(-0.3, 0.3, (3, count)))
    return position, quaternion, rng.uniform(ROBOT.joint_lower, ROBOT.joint_upper, (count, 12))


def tensors(arrays: Sequence[Any]) -> list[torch.Tensor]:
    return [torch.as_tensor(array, dtype=torch.float32) for array in arrays]


def test_torch_is_read_as_numpy_is_and_results_are_shared() -> None:
    caster = WarpRenderer(STAIRS, RobotCamera.on(ROBOT), device="cpu").caster
    where = robots(50)
    from_numpy, from_torch = caster.cast(*where), caster.cast(*tensors(where))
    differ = ~np.isclose(from_numpy.numpy(), from_torch.numpy(), rtol=0.0, atol=1e-4)
    assert differ.mean() < 1e-3  # edges, seen through the rounding of poses
    seen = warp.to_torch(from_torch)
    seen[0, 0, 0] = -1.0
    assert from_torch.numpy()[0, 0, 0] == -1.0


def test_legs_only_come_nearer() -> None:
    where = robots(60)
    with_legs, without = (
        WarpRenderer(STAIRS, RobotCamera.on(ROBOT, legs=legs), device="cpu").render_batch(*where)
        for legs in (True, False)
    )
    assert (with_legs <= without).all()
    assert (with_legs < without).any()


@pytest.mark.parametrize("legs", [True, False])
def test_every_robot_has_a_mount_of_its_own(legs: bool) -> None:
    """One cast sees what each robot's own renderer shows."""
    rng = np.random.default_rng(3)
    where = robots(6)
    shift, pitch = rng.uniform(-0.02, 0.02, (6, 3)), rng.uniform(0.4, 0.6, 6)
    each = Mount(position=ROBOT.camera_position + shift, pitch=pitch)
    caster = WarpRenderer(STAIRS, RobotCamera.on(ROBOT, legs=legs), device="cpu").caster
    caster.set_mount(each)
    together = caster.cast(*tensors(where)).numpy()
    for i in range(6):
        mount = Mount(position=each.position[i], pitch=float(pitch[i]))
        camera = replace(RobotCamera.on(ROBOT, legs=legs), mount=mount)
        alone = WarpRenderer(STAIRS, camera, device="cpu").render_batch(
            *(a[i : i + 1] for a in where)
        )
        differ = ~np.isclose(together[i], alone[0], rtol=0.0, atol=1e-3)
        assert differ.mean() < 0.01  # edges, seen through the rounding of poses
    each.position[2] = 0.0
    with pytest.raises(SaltusError, match="inside the robot"):
        caster.set_mount(each)


def test_every_robot_has_boxes_of_its_own() -> None:
    """One cast over many courses sees what each robot's own terrain shows."""
    terrains = [make_terrain(TerrainConfig(terrain="gap", gap_m=0.2 + 0.1 * i)) for i in range(4)]
    boxes = TerrainStack(terrains).boxes(3)
    where = robots(4, terrains[0])
    together = WarpCaster(boxes, RobotCamera.on(ROBOT), device="cpu").cast(*where).numpy()
    for i, terrain in enumerate(terrains):
        alone = WarpRenderer(terrain, RobotCamera.on(ROBOT), device="cpu").render(
            *(array[i] for array in where)
        )
        np.testing.assert_array_equal(together[i], alone)


def test_courses_of_training_can_be_seen() -> None:
    """Boxes that overlap are one ground: straight down it is as far as the height says."""
    rng = np.random.default_rng(1)
    count = 200
    difficulty, draws = tensors((rng.uniform(size=count), rng.uniform(size=(count, DRAWS.count))))
    courses = draw_courses(torch.arange(count) % 5, difficulty, draws)
    assert courses.boxes().center.shape == (count, BOXES, 3)
    position = np.stack(
        [rng.uniform(0.0, 5.0, count), np.zeros(count), np.full(count, 9.0)], axis=-1
    )
    level = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    plumb = Mount(position=np.array([0.0, 0.0, 0.1]), pitch=0.5 * np.pi)
    one_pixel = Intrinsics(width=1, height=1, fx=100.0, fy=100.0, cx=0.5, cy=0.5)
    caster = WarpCaster(
        courses.boxes(),
        replace(RobotCamera.on(ROBOT, one_pixel, legs=False), mount=plumb),
        device="cpu",
    )
    depth = caster.cast(*tensors((position, level, np.tile(ROBOT.stand_pose, (count, 1)))))
    ground = courses.height_at(*tensors([position[:, :1], position[:, 1:2]]))[:, 0].numpy()
    np.testing.assert_allclose(depth.numpy()[:, 0, 0], 9.1 - ground, atol=1e-5)


def test_a_camera_under_ground_sees_out_as_meshes_let_it() -> None:
    position, quaternion, joints = robots(40)
    position[:, 2] = np.random.default_rng(3).uniform(BOTTOM + 0.2, -0.3, 40)
    rays = EmbreeRenderer(STAIRS, RobotCamera.on(ROBOT, legs=False)).render_batch(
        position, quaternion, joints
    )
    boxes = WarpRenderer(STAIRS, RobotCamera.on(ROBOT, legs=False), device="cpu").render_batch(
        position, quaternion, joints
    )
    assert np.isclose(rays, boxes, rtol=0.0, atol=1e-3).mean() > 0.995


def test_the_second_view_is_that_of_embree() -> None:
    camera = supersampled_model_camera(3, 1)
    optics = StereoOptics.of(camera)
    where = robots(100)
    depth, hidden = StereoEmbree(STAIRS, optics, RobotCamera.on(ROBOT, camera)).render_pair_batch(
        *where
    )
    caster = WarpRenderer(STAIRS, RobotCamera.on(ROBOT, camera), device="cpu").caster
    own_depth, own_hidden = caster.cast_pair(*where, baseline_m=optics.baseline_m)
    assert hidden.any()
    assert np.isclose(own_depth.numpy(), depth, rtol=0.0, atol=1e-3).mean() > 0.999
    assert (own_hidden.numpy() == hidden).mean() > 0.999


def test_boxes_for_other_robots_are_refused() -> None:
    center = np.zeros((3, 1, 3))
    caster = WarpCaster(
        Boxes(center=center, half_size=center + 1.0),
        RobotCamera.on(ROBOT, MODEL_CAMERA),
        device="cpu",
    )
    with pytest.raises(SaltusError, match=r"3 robots, poses for 5"):
        caster.cast(*robots(5))
    with pytest.raises(SaltusError, match="boxes"):
        caster.set_boxes(Boxes(center=center, half_size=np.ones((3, 2, 3))))
