"""Depth of courses of columns in closed form, against rays and against the ground itself."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from samples import ROBOT

from saltus.arrays import Floats
from saltus.config import TerrainConfig
from saltus.depth import MODEL_CAMERA, Intrinsics
from saltus.render.camera import RobotCamera, camera_pose, ray_directions
from saltus.render.course_columns import SeenColumns
from saltus.render.embree import EmbreeRenderer
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import WIDTH, Terrain

KINDS = ("flat", "stairs", "stepping_stones", "step", "gap")
CROP = Intrinsics(width=80, height=240, fx=211.4, fy=211.4, cx=40.0, cy=120.0)
ONE = Intrinsics(width=1, height=1, fx=30.0, fy=30.0, cx=0.5, cy=0.5)
CAMERAS = {"model": MODEL_CAMERA, "crop": CROP, "one pixel": ONE}
UPRIGHT, ANY = np.array([0.2, 0.4, 0.6]), np.array([np.pi, np.pi, np.pi])
COUNT = 120  # of 40 that are turned in any way, columns can draw none in 3 of 1,000 draws
FAR_M = 20.0
EDGE = 1e-4  # share of pixels whose ray passes an edge within the rounding of single precision


def views(terrain: Terrain, seed: int, turned: Floats) -> tuple[Floats, Floats]:
    """Origins and rotations of cameras above the course, and a few beside and below it."""
    rng = np.random.default_rng(seed)
    position = rng.uniform([-0.5, -0.5, 0.2], [6.0, 0.5, 0.5], (COUNT, 3))
    position[:, 2] += terrain.height_at(position[:, 0], position[:, 1])
    quaternion = quaternion_from_roll_pitch_yaw(*rng.uniform(-turned, turned, (COUNT, 3)).T)
    return camera_pose(RobotCamera.on(ROBOT).mount, position, quaternion)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 10_000), difficulty=st.floats(0.0, 1.0), upright=st.booleans())
def test_it_is_what_rays_say(
    camera: Intrinsics, kind: str, seed: int, difficulty: float, upright: bool
) -> None:
    terrain = make_terrain(TerrainConfig(terrain=kind, difficulty=difficulty, layout_seed=seed))
    renderer = EmbreeRenderer(terrain, RobotCamera.on(ROBOT, camera, legs=False))
    assert terrain.columns is not None
    course = SeenColumns(terrain.columns, camera)
    origin, rotation = views(terrain, seed, UPRIGHT if upright else ANY)
    sees = course.sees(origin, rotation)
    assert sees.mean() > (0.6 if upright else 0.0)
    rays = renderer._hit(origin, rotation)
    drawn = renderer._cast(origin, rotation)
    np.testing.assert_array_equal(drawn[~sees], rays[~sees])
    depth = course.depth(origin[sees], rotation[sees])
    np.testing.assert_array_equal(drawn[sees], depth)
    near, far = np.minimum(depth, FAR_M), np.minimum(rays[sees], FAR_M)
    assert (np.abs(near - far) > 1e-4 * far).sum() <= max(3, EDGE * near.size)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10_000), difficulty=st.floats(0.0, 1.0))
def test_it_ends_on_the_ground_and_the_way_there_is_free(
    kind: str, seed: int, difficulty: float
) -> None:
    terrain = make_terrain(TerrainConfig(terrain=kind, difficulty=difficulty, layout_seed=seed))
    assert terrain.columns is not None
    columns, course = terrain.columns, SeenColumns(terrain.columns, MODEL_CAMERA)
    origin, rotation = views(terrain, seed, UPRIGHT)
    seen = course.sees(origin, rotation)
    origin, rotation = origin[seen], rotation[seen]
    depth = course.depth(origin, rotation).astype(np.float64)
    ray = (ray_directions(MODEL_CAMERA).reshape(-1, 3) @ rotation.mT).reshape(*depth.shape, 3)
    hit = np.isfinite(depth)
    start, ray, depth = np.broadcast_to(origin[:, None, None], ray.shape)[hit], ray[hit], depth[hit]
    end = start + depth[:, None] * ray
    tolerance = 1e-5 * (1.0 + depth)
    ground = np.stack([columns.height_at(end[:, 0] + side * tolerance) for side in (-1, 0, 1)])
    assert (end[:, 2] <= ground.max(axis=0) + tolerance).all()
    assert (end[:, 2] >= ground.min(axis=0) - tolerance).all()
    assert (np.abs(end[:, 1]) <= 0.5 * WIDTH + tolerance).all()
    for share in np.linspace(0.05, 0.999, 40):
        way = start + share * depth[:, None] * ray
        assert (way[:, 2] >= columns.height_at(way[:, 0]) - tolerance).mean() > 1.0 - 10 * EDGE


def test_a_camera_within_the_ground_beside_it_or_upside_down_gets_rays() -> None:
    terrain = make_terrain(TerrainConfig(terrain="stairs"))
    assert terrain.columns is not None
    course = SeenColumns(terrain.columns, MODEL_CAMERA)
    level = camera_pose(RobotCamera.on(ROBOT).mount, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))[1]
    top = float(terrain.height_at(np.asarray(3.0), np.asarray(0.0)))
    end = float(terrain.columns.x[-1])
    for place, sees in (
        ((3.0, 0.0, top + 0.3), True),
        ((3.0, 0.0, top - 0.1), False),
        ((3.0, 0.5 * WIDTH + 0.1, top + 0.3), False),
        ((end + 0.1, 0.0, top + 0.3), False),
    ):
        assert course.sees(np.array([place]), level[None])[0] == sees
    over = np.diag([-1.0, -1.0, 1.0])  # turned by half a turn about its axis
    assert not course.sees(np.array([[3.0, 0.0, top + 0.3]]), (level @ over)[None])[0]
