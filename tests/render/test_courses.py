"""Courses in two dimensions: truth, rays of all back ends and contacts agree,
whatever was drawn.
"""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from samples import ROBOT

from saltus.config import TerrainConfig
from saltus.depth import Intrinsics
from saltus.errors import ConfigError
from saltus.render.backends import make_renderer
from saltus.render.camera import RobotCamera
from saltus.render.warp import WarpRenderer
from saltus.robots.mount import Mount
from saltus.sim.robot_model import TERRAIN_GEOM, add_boxes
from saltus.terrain.course import Course, shipped_courses
from saltus.terrain.course_segments import SEGMENTS, RandomSizes
from saltus.terrain.curriculum import is_drawn, make_terrain
from saltus.terrain.terrain import Terrain

AGREES_M = 5e-3
BALL_M = 0.005
"""Radius of a ball that feels the ground: on a slope of 45 degrees it touches 2 mm early."""
STEEPEST = 1.0
EYE = Intrinsics(width=1, height=1, fx=100.0, fy=100.0, cx=0.5, cy=0.5)
COURSES = [(name, seed) for name in (*shipped_courses(), "all kinds") for seed in range(4)]


def drawn(name: str, seed: int) -> Terrain:
    if name != "all kinds":
        return make_terrain(TerrainConfig(terrain=name, layout_seed=seed))
    rng = np.random.default_rng(seed)
    segments = tuple(SEGMENTS[kind]() for kind in rng.permutation(sorted(SEGMENTS)))
    return Course(kind=name, segments=segments, width=1.5, floor_m=0.2).terrain(RandomSizes(rng))


@pytest.fixture(scope="module", params=COURSES, ids=lambda case: f"{case[0]}-{case[1]}")
def terrain(request: pytest.FixtureRequest) -> Terrain:
    return drawn(*request.param)


@pytest.fixture(scope="module")
def places(terrain: Terrain) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places and their heights, at least a ball away from any edge."""
    ground, rng = terrain.boxes[0], np.random.default_rng(0)
    x, y = (rng.uniform(ground.low[i] + 0.1, ground.high[i] - 0.1, 400) for i in (0, 1))
    height, reach = terrain.height_at(x, y), 2.0 * BALL_M
    around = [
        terrain.height_at(x + a * reach, y + b * reach)
        for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1))
    ]
    clear = np.abs(np.array(around) - height).max(axis=0) < STEEPEST * reach
    return x[clear], y[clear], height[clear]


@pytest.mark.sample(8)
def test_rays_of_all_back_ends_end_where_the_truth_is(
    terrain: Terrain, places: tuple[np.ndarray, ...]
) -> None:
    x, y, height = places
    down = Mount(position=np.array([0.0, 0.0, 1.0]), pitch=0.5 * np.pi)
    eye = RobotCamera(robot=ROBOT, intrinsics=EYE, mount=down, legs=False)
    above = float(height.max()) + 2.0
    position = np.column_stack([x, y, np.full_like(x, above - 1.0)])
    quaternion, joints = (
        np.tile([1.0, 0.0, 0.0, 0.0], (len(x), 1)),
        np.tile(ROBOT.stand_pose, (len(x), 1)),
    )
    for renderer in (
        make_renderer("embree", terrain, eye),
        make_renderer("pyrender", terrain, eye),
        WarpRenderer(terrain, eye, device="cpu"),
    ):
        depth = renderer.render_batch(position, quaternion, joints)[:, 0, 0]
        np.testing.assert_allclose(above - depth, height, atol=AGREES_M, err_msg=renderer.name)


def test_a_ball_touches_the_ground_where_the_truth_is(
    terrain: Terrain, places: tuple[np.ndarray, ...]
) -> None:
    spec = mujoco.MjSpec()
    add_boxes(spec, terrain.arrays)
    ball = spec.worldbody.add_body(name="ball")
    ball.add_freejoint()
    ball.add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[BALL_M, 0, 0], contype=0, conaffinity=1, margin=1.0
    )
    model = spec.compile()
    assert model.geom(TERRAIN_GEOM.format(len(terrain.boxes) - 1)).id == len(terrain.boxes) - 1
    data = mujoco.MjData(model)
    for x, y, height in zip(*places, strict=True):
        data.qpos[:3] = x, y, height + BALL_M
        mujoco.mj_fwdPosition(model, data)
        assert abs(data.contact.dist.min()) < AGREES_M, (x, y)


def test_a_robot_can_start_and_its_way_does_not_end_before_its_last_segment(
    terrain: Terrain,
) -> None:
    x = np.linspace(-0.5, 0.5, 11)
    np.testing.assert_allclose(terrain.height_at(x, 0.0 * x), 0.0, atol=1e-9)
    assert terrain.finish_x > terrain.start_x
    assert Terrain.from_toml(terrain.to_toml()) == terrain


@pytest.mark.parametrize("name", shipped_courses())
def test_seeds_draw_other_courses(name: str) -> None:
    assert is_drawn(TerrainConfig(terrain=name))
    assert drawn(name, 0) == drawn(name, 0) != drawn(name, 1)


def test_the_easiest_course_has_the_first_of_two_sizes_and_harder_ones_go_further() -> None:
    stairs = Course(kind="stairs", segments=(SEGMENTS["stairs"](rise=(0.1, 0.2), steps=1),))
    highest = {
        d: max(
            stairs.terrain(RandomSizes(np.random.default_rng(s), d)).boxes[-1].high[2]
            for s in range(50)
        )
        for d in (0, 0.5, 1)
    }
    assert highest[0] == pytest.approx(0.1)
    assert 0.1 < highest[0.5] <= 0.15 < highest[1] <= 0.2


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("kind = 'x'\nsegments = []", "no segments"),
        ("kind = 'x'\n[[segments]]\nkind = 'stair'", "did you mean 'stairs'"),
        ("kind = 'x'\n[[segments]]\nlength = 1", r"segments\[0\].kind"),
        ("kind = 'x'\n[[segments]]\nkind = 'level'\nlenght = 1", "did you mean 'length'|length"),
        ("kind = 'x'\n[[segments]]\nkind = 'level'\nlength = -1", "level.length = -1"),
        ("kind = 'x'\n[[segments]]\nkind = 'turn'\nangle = 90", "in radians"),
        ("kind = 'x'\nwidth = 0\n[[segments]]\nkind = 'level'", "width"),
    ],
)
def test_what_is_no_course_is_refused_in_one_line(text: str, named: str, tmp_path: Path) -> None:
    (tmp_path / "course.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=named) as error:
        make_terrain(TerrainConfig(terrain=str(tmp_path / "course.toml")))
    assert "\n" not in str(error.value)
    assert "course.toml" in str(error.value)
