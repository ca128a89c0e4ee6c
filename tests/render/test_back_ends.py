import itertools
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from random_terrain import places, random_terrain
from samples import ROBOT
from stereo_scenes import poses

from saltus.arrays import Floats
from saltus.config import TerrainConfig
from saltus.depth import D435I, MODEL_CAMERA, Intrinsics
from saltus.errors import ConfigError, SaltusError
from saltus.render._gl import gl_platform
from saltus.render.backends import make_renderer, preference
from saltus.render.camera import RobotCamera, camera_pose, ray_directions
from saltus.render.embree import EmbreeRenderer
from saltus.render.renderer import Renderer
from saltus.render.warp import WarpRenderer
from saltus.robots.mount import Mount
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import RUN_OUT, WIDTH, Terrain

KINDS: tuple[str, ...] = ("flat", "stairs", "stepping_stones", "step", "gap")
POSES = 200
FAR = 5.0  # comparison beyond what the model sees (3 m); a rasteriser's depth gets coarse [m]
EDGE = (
    0.01  # neighbours that differ by more than this beyond a smooth surface make a depth edge [m]
)


def terrain_of(kind: str) -> Terrain:
    return make_terrain(TerrainConfig(terrain=kind, difficulty=0.4))


def smooth(depth: Floats) -> np.ndarray:
    """Pixels away from depth edges: second differences along both axes are small."""
    edge = np.zeros(depth.shape, dtype=bool)
    for axis in (-2, -1):
        bend = np.abs(np.diff(depth, n=2, axis=axis)) > EDGE
        pad = [(0, 0)] * depth.ndim
        for before in (0, 1, 2):  # all three pixels of a bend
            pad[axis] = (before, 2 - before)
            edge |= np.pad(bend, pad)
    return ~edge


@pytest.fixture(params=[MODEL_CAMERA, D435I], ids=lambda c: f"{c.width}x{c.height}")
def camera(request: pytest.FixtureRequest) -> Intrinsics:
    return request.param  # type: ignore[no-any-return]


@pytest.fixture(params=KINDS)
def back_ends(request: pytest.FixtureRequest, camera: Intrinsics) -> list[Renderer]:
    terrain = terrain_of(request.param)
    eye = RobotCamera.on(ROBOT, camera)
    return [
        *(make_renderer(name, terrain, eye) for name in ("embree", "pyrender")),
        WarpRenderer(terrain, eye, device="cpu"),
    ]


@pytest.mark.sample(5)
def test_all_back_ends_see_the_same(back_ends: list[Renderer], camera: Intrinsics) -> None:
    """Within 1 mm on 99.5 % of the pixels off depth edges;
    Warp and Embree, which both cast rays, on all.
    """
    terrain, count = back_ends[0].terrain, POSES if camera is MODEL_CAMERA else 6
    where = poses(terrain, count, seed=5)
    images = [np.minimum(renderer.render_batch(*where), FAR) for renderer in back_ends]
    bare = np.minimum(
        EmbreeRenderer(terrain, RobotCamera.on(ROBOT, camera, legs=False)).render_batch(*where), FAR
    )
    legs = images[0] < bare
    assert legs.any(axis=(1, 2)).sum() >= 0.5 * count  # legs in view
    for one, other in itertools.combinations(images, 2):
        judged = smooth(one) & smooth(other)
        assert judged.mean() > 0.5
        agree = np.abs(one - other) <= 1e-3
        assert agree[judged].mean() >= 0.995
        assert agree[legs & judged].mean() >= 0.995
        assert agree.mean() >= 0.99  # edges and all
    assert (np.abs(images[0] - images[2]) <= 1e-3).mean() > 0.9999


def test_depth_is_that_of_the_ground(camera: Intrinsics) -> None:
    """On flat ground every ray's depth is known."""
    renderer = EmbreeRenderer(terrain_of("flat"), RobotCamera.on(ROBOT, camera, legs=False))
    position, quaternion, joints = poses(renderer.terrain, 20, seed=1)
    depth = renderer.render_batch(position, quaternion, joints)
    origin, rotation = camera_pose(Mount.of(ROBOT), position, quaternion)
    rays = (ray_directions(camera).reshape(-1, 3) @ rotation.mT).reshape(*depth.shape, 3)
    down = rays[..., 2] < 0.0
    expected = -origin[:, 2, None, None] / np.where(down, rays[..., 2], 1.0)
    hit = origin[:, None, None, :] + expected[..., None] * rays
    course = renderer.terrain
    inside = (
        down
        & (hit[..., 0] < course.finish_x + RUN_OUT - 0.1)
        & (np.abs(hit[..., 1]) < 0.5 * WIDTH - 0.1)
    )
    assert inside.mean() > 0.3
    np.testing.assert_allclose(depth[inside], expected[inside], rtol=1e-4)
    assert np.isinf(depth[~down]).all()


@pytest.mark.parametrize("terrain", [*map(terrain_of, KINDS), *map(random_terrain, range(4))])
def test_straight_down_it_is_as_far_as_the_height_says(terrain: Terrain) -> None:
    x, y = places(terrain, 300, seed=4)
    position = np.stack([x, y, np.full(len(x), 9.0)], axis=-1)
    level, joints = (
        np.tile([1.0, 0.0, 0.0, 0.0], (len(x), 1)),
        np.tile(ROBOT.stand_pose, (len(x), 1)),
    )
    plumb = Mount(position=np.array([0.0, 0.0, 0.1]), pitch=0.5 * np.pi)
    one_pixel = Intrinsics(width=1, height=1, fx=100.0, fy=100.0, cx=0.5, cy=0.5)
    looking_down = replace(RobotCamera.on(ROBOT, one_pixel, legs=False), mount=plumb)
    for renderer in (EmbreeRenderer, WarpRenderer):
        depth = renderer(terrain, looking_down).render_batch(position, level, joints)
        np.testing.assert_allclose(
            depth[:, 0, 0], 9.1 - terrain.height_at(x, y), atol=2e-6 if terrain.columns else 2e-5
        )


@pytest.mark.parametrize("back_end", ["embree", "pyrender", "warp"])
def test_one_pose_is_a_batch_of_one(back_end: str) -> None:
    renderer = make_renderer(back_end, terrain_of("stairs"), RobotCamera.on(ROBOT))
    where = poses(renderer.terrain, 10, seed=2)
    together = renderer.render_batch(*where)
    for i in range(10):
        alone = renderer.render(*(array[i] for array in where))
        assert (alone.dtype, alone.shape) == (np.float32, together.shape[1:])
        np.testing.assert_array_equal(alone, together[i])


def test_renderers_draw_in_turn() -> None:
    """Those of pyrender with images of one size share a context."""
    some = [
        make_renderer("pyrender", terrain_of(kind), RobotCamera.on(ROBOT))
        for kind in ("stairs", "gap")
    ]
    where = poses(some[0].terrain, 3, seed=2)
    first, again = ([renderer.render_batch(*where) for renderer in some] for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert (first[0] != first[1]).any()


def test_a_renderer_that_does_not_exist() -> None:
    with pytest.raises(ConfigError, match="embree"):
        make_renderer("embre", terrain_of("flat"), RobotCamera.on(ROBOT))


def test_the_fastest_is_taken() -> None:
    """Embree for small images; for large ones a GPU where there is one, else the rasteriser."""
    assert make_renderer("auto", terrain_of("flat"), RobotCamera.on(ROBOT)).name == "embree"
    large = make_renderer("auto", terrain_of("flat"), RobotCamera.on(ROBOT, D435I))
    assert large.name == preference(D435I)[0]


def test_auto_takes_the_next_where_a_library_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "saltus.render.pyrender_osmesa", None)
    monkeypatch.setattr("saltus.render.backends.has_driver", lambda: False)
    assert make_renderer("auto", terrain_of("flat"), RobotCamera.on(ROBOT, D435I)).name == "embree"
    with pytest.raises(SaltusError, match="pyrender renderer cannot be loaded"):
        make_renderer("pyrender", terrain_of("flat"), RobotCamera.on(ROBOT))


@pytest.mark.parametrize(
    ("installed", "platform"), [("OSMesa", "osmesa"), ("EGL", "egl"), (None, "osmesa")]
)
def test_egl_where_osmesa_is_gone(
    monkeypatch: pytest.MonkeyPatch, installed: str | None, platform: str
) -> None:
    monkeypatch.delenv("PYOPENGL_PLATFORM", raising=False)
    monkeypatch.setattr(
        "ctypes.util.find_library", lambda name: name if name == installed else None
    )
    assert gl_platform() == platform
    monkeypatch.setenv("PYOPENGL_PLATFORM", "glx")
    with pytest.raises(SaltusError, match="glx"):
        gl_platform()


ON_EGL = """
import numpy
from benchmarks.render import ROBOT, TERRAIN, poses
from saltus.render.backends import make_renderer
from saltus.render.camera import RobotCamera

robots, camera = poses(60), RobotCamera.on(ROBOT)
rays, raster = (
    numpy.minimum(make_renderer(name, TERRAIN, camera).render_batch(*robots), 5.0) for name in ("embree", "pyrender")
)
print((abs(rays - raster) <= 1e-3).mean())
"""


def test_egl_draws_what_osmesa_draws() -> None:
    """In a process of its own: one process draws on one of them.

    Here all pixels are judged, those on edges too.
    """
    environment = {**os.environ, "PYOPENGL_PLATFORM": "egl"}
    result = subprocess.run(
        [sys.executable, "-c", ON_EGL], capture_output=True, text=True, env=environment, check=True
    )
    assert float(result.stdout) > 0.99


BESIDE_MUJOCO = """
import mujoco, numpy
from saltus.render.backends import make_renderer
from saltus.render.camera import RobotCamera
from saltus.config import TerrainConfig
from saltus.robots.loading import load_robot
from saltus.sim.robot_model import build_spec
from saltus.terrain.curriculum import make_terrain

terrain = make_terrain(TerrainConfig(terrain="stairs"))
robot = load_robot("go1")
pose = numpy.array([0.5, 0.0, 0.3]), numpy.array([1.0, 0.0, 0.0, 0.0]), robot.stand_pose
camera = make_renderer("pyrender", terrain, RobotCamera.on(robot))
first = camera.render(*pose)
model = build_spec(robot, terrain).compile()
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
video = mujoco.Renderer(model, 48, 64)
for _ in range(5):
    video.update_scene(data)
    assert video.render().any()
    assert (camera.render(*pose) == first).all()
video.close()
assert (camera.render(*pose) == first).all()
"""


def test_pyrender_and_mujoco_share_a_process() -> None:
    environment = {**os.environ, "MUJOCO_GL": "osmesa"}
    result = subprocess.run(
        [sys.executable, "-c", BESIDE_MUJOCO], capture_output=True, text=True, env=environment
    )
    assert (result.returncode, result.stderr) == (0, "")


GROWTH = """
import sys, numpy
from benchmarks._measuring import own_processes, resident_mb
from benchmarks.render import ROBOT, TERRAIN, poses
from saltus.render.backends import make_renderer
from saltus.render.camera import RobotCamera

robots = poses(100)
def render(count):
    for _ in range(0, count, 100):
        make_renderer(sys.argv[1], TERRAIN, RobotCamera.on(ROBOT)).render_batch(*robots)
    return resident_mb(own_processes())
first = render(500)
print(render(4000) - first)
"""


@pytest.mark.slow
@pytest.mark.parametrize("back_end", ["embree", "pyrender", "warp"])
def test_thousands_of_frames_of_many_renderers_leave_no_memory_behind(back_end: str) -> None:
    """In a process of its own, so that nothing else grows or shrinks meanwhile."""
    command = [sys.executable, "-c", GROWTH, back_end]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    assert float(result.stdout) < 5.0
