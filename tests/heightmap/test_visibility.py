"""Which ground a camera has seen: held to rays that are cast."""

import numpy as np
import pytest
from samples import ROBOT

from saltus import rotations
from saltus.config import TerrainConfig
from saltus.depth import MODEL_CAMERA, RANGE_M
from saltus.grid import HEIGHTMAP_X, LINE
from saltus.heightmap.evaluation.visibility import (
    BIN_M,
    REMEMBERED,
    UNSEEN,
    VISIBLE,
    seen_by_rays,
    visibility,
)
from saltus.render.camera import RobotCamera, camera_pose, ray_directions
from saltus.render.embree import EmbreeRenderer
from saltus.robots.mount import Mount
from saltus.terrain.curriculum import make_terrain

KINDS: tuple[str, ...] = ("flat", "stairs", "stepping_stones", "step", "gap")
PLACES = 12


def poses(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Over the ground that begins at 0, in any attitude of a bound."""
    x = rng.uniform(-0.5, 1.5, count)
    position = np.stack([x, rng.uniform(-0.1, 0.1, count), rng.uniform(0.25, 0.45, count)], -1)
    angles = rng.uniform([[-0.05], [-0.35], [-0.1]], [[0.05], [0.35], [0.1]], (3, count))
    return position, rotations.quaternion_from_roll_pitch_yaw(*angles)


@pytest.mark.parametrize("kind", KINDS)
def test_what_a_ray_hits_is_met_and_what_is_met_is_hit(kind: str) -> None:
    terrain = make_terrain(TerrainConfig(terrain=kind, difficulty=0.3))
    position, quaternion = poses(np.random.default_rng(1), PLACES)
    position[:, 2] += np.maximum(terrain.height_at(position[:, 0], position[:, 1]), 0.0)
    ground = np.arange(-1.0, 6.0, BIN_M)
    seen = seen_by_rays(terrain, Mount.of(ROBOT), ground, position, quaternion)
    joints = np.tile(ROBOT.stand_pose, (PLACES, 1))
    depth = EmbreeRenderer(
        terrain, RobotCamera.on(ROBOT, MODEL_CAMERA, legs=False), threads=1
    ).render_batch(position, quaternion, joints)
    origin, rotation = camera_pose(Mount.of(ROBOT), position, quaternion)
    rays = ray_directions(MODEL_CAMERA)[:, 7:9].mean(1) @ np.swapaxes(np.asarray(rotation), -1, -2)
    hit = np.asarray(origin)[:, None] + depth[:, :, 7:9].mean(-1)[..., None] * rays
    for i in range(PLACES):
        # On the ground, not on a wall
        up = np.abs(hit[i, :, 2] - terrain.height_at(hit[i, :, 0], hit[i, :, 1])) < 1e-3
        up &= depth[i, :, 7:9].max(-1) < RANGE_M
        nearest = np.abs(hit[i, up, 0][:, None] - ground).argmin(-1)
        around = seen[i, nearest] | seen[i, np.maximum(nearest - 1, 0)] | seen[i, nearest + 1]
        assert around.mean() > 0.95  # but for a ray that passes within a bin of an edge
        # Farther away pixels are far apart
        places = ground[seen[i] & (ground < position[i, 0] + HEIGHTMAP_X[-1])]
        assert (np.abs(places[:, None] - hit[i, :, 0]).min(-1, initial=np.inf) < 0.2).all()


def test_ground_is_visible_then_remembered_and_never_met_before() -> None:
    terrain = make_terrain(TerrainConfig(terrain="flat"))
    ticks = 200
    position = np.tile([0.0, 0.0, ROBOT.stand_height], (ticks, 1))
    position[:, 0] = np.linspace(0.0, 3.0, ticks)
    quaternion = np.tile([1.0, 0.0, 0.0, 0.0], (ticks, 1))
    captured_s = np.where(
        np.arange(ticks) < 10, -np.inf, np.floor(0.5 * (np.arange(ticks) - 10)) * 0.02
    )
    view = visibility(terrain, Mount.of(ROBOT), LINE, position, quaternion, captured_s)
    assert (view[:10] == UNSEEN).all()
    assert (view[12:, HEIGHTMAP_X > 0.7] == VISIBLE).all()
    assert (view[12, HEIGHTMAP_X < 0.2] == UNSEEN).all()
    assert (view[-1, HEIGHTMAP_X < 0.0] == REMEMBERED).all()
    blind = visibility(
        terrain, Mount.of(ROBOT), LINE, position, quaternion, np.minimum(captured_s, 0.5)
    )
    assert (blind[-1] != VISIBLE).all()
