import mujoco
import numpy as np
import pytest
from samples import ROBOT

from saltus.config import TerrainConfig
from saltus.depth import D435I, MODEL_CAMERA, Intrinsics
from saltus.render.camera import camera_pose, ray_directions
from saltus.render.capsules import Quadrics, capsules_in_camera, draw_capsules
from saltus.robots.leg_shapes import Capsules, LegShapes
from saltus.robots.mount import Mount
from saltus.robots.robot import LEGS
from saltus.rotations import quaternion_from_roll_pitch_yaw, rotation_matrix
from saltus.sim.robot_model import build_spec
from saltus.terrain.curriculum import make_terrain

SHAPES = LegShapes(ROBOT)


def test_links_are_where_the_simulator_has_them() -> None:
    rng = np.random.default_rng(0)
    model = build_spec(ROBOT, make_terrain(TerrainConfig(terrain="flat"))).compile()
    data = mujoco.MjData(model)
    for _ in range(50):
        joints = rng.uniform(ROBOT.joint_lower, ROBOT.joint_upper)
        rotation = rng.uniform(-0.5, 0.5, 3)
        position = rng.uniform(-1.0, 1.0, 3)
        data.qpos[:] = np.concatenate([position, quaternion_from_roll_pitch_yaw(*rotation), joints])
        mujoco.mj_kinematics(model, data)
        legs = SHAPES.capsules(joints)
        base = rotation_matrix(data.qpos[3:7])
        for i, leg in enumerate(LEGS):
            for place, body in ((i, f"{leg}_thigh"), (4 + i, f"{leg}_calf")):
                np.testing.assert_allclose(
                    position + base @ legs.start[place], data.body(body).xpos, atol=1e-9
                )
            foot = data.geom(f"{leg}_foot").xpos
            np.testing.assert_allclose(position + base @ legs.end[4 + i], foot, atol=1e-9)
            np.testing.assert_allclose(position + base @ legs.start[8 + i], foot, atol=1e-9)


def distance_to_axis(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    axis = end - start
    share = np.clip((points - start) @ axis / max(float(axis @ axis), 1e-12), 0.0, 1.0)
    return np.linalg.norm(points - start - share[..., None] * axis, axis=-1)


@pytest.mark.parametrize("seed", range(20))
def test_rays_enter_capsules_at_their_surface(seed: int) -> None:
    """Where a ray enters it is at the radius, before that outside,
    and a ray that misses is never inside.
    """
    rng = np.random.default_rng(seed)
    start = np.array([*rng.uniform(-0.15, 0.15, 2), rng.uniform(0.1, 0.6)])
    end = start + (rng.uniform(-0.2, 0.2, 3) if seed % 4 else 0.0)
    radius = 0.02
    directions = ray_directions(MODEL_CAMERA).reshape(-1, 3)
    depth = Quadrics.of(start, end, radius).depth(directions[..., 0], directions[..., 1])
    hit = np.isfinite(depth)
    at_entry = distance_to_axis(depth[hit, None] * directions[hit], start, end)
    np.testing.assert_allclose(at_entry, radius, atol=1e-9)
    samples = np.linspace(0.0, 1.0, 400)[:, None, None]
    before = np.where(hit, depth, 1.5)[:, None] * directions
    assert (distance_to_axis(samples * before, start, end) >= radius - 1e-9).all()


@pytest.mark.parametrize("camera", [MODEL_CAMERA, D435I], ids=lambda c: f"{c.width}x{c.height}")
def test_nothing_is_missed_outside_the_windows(camera: Intrinsics) -> None:
    """Drawing only where a capsule can be gives what drawing everywhere gives."""
    rng = np.random.default_rng(2)
    start = rng.uniform([-0.4, -0.4, -0.1], [0.4, 0.4, 0.6], (3, 20, 3))
    capsules = Capsules(
        start=start, end=start + rng.uniform(-0.2, 0.2, start.shape), radius=np.full(20, 0.02)
    )
    directions = ray_directions(camera)
    drawn = np.full((3, camera.height, camera.width), np.inf, dtype=np.float32)
    draw_capsules(drawn, capsules, directions, camera)
    for image in range(3):
        expected = np.full(drawn.shape[1:], np.inf)
        for k in range(20):
            hit = Quadrics.of(capsules.start[image, k], capsules.end[image, k], 0.02).depth(
                directions[..., 0], directions[..., 1]
            )
            expected = np.minimum(expected, hit)
        np.testing.assert_array_equal(drawn[image], expected.astype(np.float32))


def test_the_camera_looks_forward_and_down() -> None:
    centre, rotation = camera_pose(
        Mount.of(ROBOT), np.array([1.0, 2.0, 0.3]), np.array([1.0, 0.0, 0.0, 0.0])
    )
    np.testing.assert_allclose(centre, np.array([1.0, 2.0, 0.3]) + ROBOT.camera_position)
    forward, right, down = rotation[:, 2], rotation[:, 0], rotation[:, 1]
    np.testing.assert_allclose(forward, [np.cos(0.52), 0.0, -np.sin(0.52)])
    np.testing.assert_allclose(right, [0.0, -1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(np.cross(forward, right), down)


def test_legs_follow_the_camera_frame() -> None:
    legs = SHAPES.capsules(ROBOT.stand_pose)
    mount = Mount.of(ROBOT)
    seen = capsules_in_camera(legs, mount.position, mount.rotation)
    np.testing.assert_allclose(
        seen.start @ mount.rotation.T + mount.position, legs.start, atol=1e-12
    )
