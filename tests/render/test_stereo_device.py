"""On a GPU the stereo camera waits for no value, and its images are those of the processor."""

from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from samples import ROBOT
from torch.utils._python_dispatch import TorchDispatchMode

from saltus.config import TerrainConfig
from saltus.depth import supersampled_model_camera
from saltus.effects.effect import map_arrays
from saltus.render.camera import RobotCamera
from saltus.render.holes import filled_along_rows, filled_from_around
from saltus.render.stereo.camera import StereoCamera, StereoConfig
from saltus.render.stereo.edges import FlyingPixels, StereoEdgeHoles
from saltus.render.stereo.image import ArrayWindows
from saltus.render.stereo.matching import Background
from saltus.render.stereo.optics import StereoOptics
from saltus.render.stereo_embree import StereoEmbree
from saltus.render.stereo_torch import KorniaWindows
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.terrain.curriculum import make_terrain

ASKED_BY = ("saltus.render.holes", "saltus.render.postfilter")
COUNT, FRAMES = 24, 4
SAMPLES = [(3, 1), (5, 5)]
EACH_ITS_OWN = replace(
    StereoConfig(),
    background=Background(distance=np.where(np.arange(COUNT) % 2 == 0, np.inf, 6.0)),
    edge_holes=StereoEdgeHoles(fraction=np.linspace(0.0, 0.5, COUNT)),
    flying_pixels=FlyingPixels(fraction=np.linspace(0.0, 0.6, COUNT)),
)


class NoTransfers(TorchDispatchMode):
    """Refuses operations on arrays of the processor:
    a GPU's stream is waited for when they are sent there.
    """

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        for given in args:
            assert (
                not isinstance(given, torch.Tensor)
                or given.device.type == "meta"
                or given.ndim == 0
            ), func
        return func(*args, **(kwargs or {}))


@pytest.fixture
def nothing_on_host(monkeypatch: pytest.MonkeyPatch) -> None:
    """All is done as on a GPU."""
    for module in ASKED_BY:
        monkeypatch.setattr(f"{module}.on_host", lambda _: False)


def scene(rows: int, columns: int) -> tuple[StereoOptics, torch.Tensor, torch.Tensor]:
    """Robots before and on stairs, legs in view of some."""
    rng = np.random.default_rng(2)
    terrain = make_terrain(TerrainConfig(terrain="stairs", rise_m=0.06))
    camera = supersampled_model_camera(rows, columns)
    position = rng.uniform([0.5, -0.1, 0.25], [4.0, 0.1, 0.5], (COUNT, 3))
    position[:, 2] += terrain.height_at(position[:, 0], position[:, 1])
    quaternion = quaternion_from_roll_pitch_yaw(*rng.uniform(-0.3, 0.3, (3, COUNT)))
    pair = StereoEmbree(terrain, StereoOptics.of(camera), RobotCamera.on(ROBOT, camera))
    depth, hidden = pair.render_pair_batch(
        position, quaternion, ROBOT.stand_pose + rng.normal(0.0, 0.4, (COUNT, 12))
    )
    return pair.optics, torch.from_numpy(depth), torch.from_numpy(hidden)


def images(
    config: StereoConfig,
    optics: StereoOptics,
    depth: Any,
    hidden: Any,
    device: str = "cpu",
    watch: Any = None,
) -> list[torch.Tensor]:
    """Images of the cameras, one exposure after the other; the third comes twice.

    Steps are taken under `watch`.
    """
    stereo = StereoCamera(config, optics, KorniaWindows())
    drawn = stereo.init((COUNT,), np.random.default_rng(5))
    state = map_arrays(lambda array: torch.as_tensor(array, device=device), drawn)
    shown = []
    for k in (0, 1, 2, 2, 3):
        time_s = torch.full((COUNT,), 0.02 * k, dtype=torch.float64, device=device)
        with watch or nullcontext():
            image, state = stereo.step(depth, hidden, time_s, state)
        shown.append(image.depth)
    return shown


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    "config", [StereoConfig(), EACH_ITS_OWN], ids=["one camera", "each its own"]
)
@pytest.mark.parametrize("samples", SAMPLES)
def test_no_shape_and_no_step_depends_on_values(
    config: StereoConfig, samples: tuple[int, int]
) -> None:
    """Tensors that have a shape but no values go through:
    to ask for a value, or for how many there are, raises.
    """
    camera = supersampled_model_camera(*samples)
    shape = COUNT, camera.height, camera.width
    depth = torch.empty(shape, device="meta")
    hidden = torch.empty(shape, dtype=torch.bool, device="meta")
    for image in images(config, StereoOptics.of(camera), depth, hidden, "meta"):
        assert (tuple(image.shape), image.device.type, image.dtype) == (
            shape,
            "meta",
            torch.float32,
        )
    if config is not EACH_ITS_OWN:  # whose parameters are numpy's, and are sent at every step
        images(config, StereoOptics.of(camera), depth, hidden, "meta", watch=NoTransfers())
    with pytest.raises(NotImplementedError):
        torch.nonzero(hidden)
    with pytest.raises(RuntimeError):
        bool(hidden.any())


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    "config", [StereoConfig(), EACH_ITS_OWN], ids=["one camera", "each its own"]
)
@pytest.mark.parametrize("samples", SAMPLES)
def test_images_are_those_of_the_processor(
    config: StereoConfig, samples: tuple[int, int], request: pytest.FixtureRequest
) -> None:
    """To the bit."""
    seen = scene(*samples)
    on_host = images(config, *seen)
    request.getfixturevalue("nothing_on_host")
    for one, other in zip(on_host, images(config, *seen), strict=True):
        torch.testing.assert_close(one, other, rtol=0.0, atol=0.0)
    # with nothing behind the terrain, cameras that look over it keep holes that no filter can fill
    assert (
        any(bool(torch.any(image[::2] == 0.0)) for image in on_host) or config is not EACH_ITS_OWN
    )


@pytest.mark.parametrize("share", [0.02, 0.3, 0.8, 0.97])
def test_holes_of_any_image_are_filled_alike(share: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Wide, tall, and narrow images.

    Whole-image operations against lists, which are tested against plain scans.
    """
    rng = np.random.default_rng(4)
    cases = []
    for height, width in ((3, 3), (4, 17), (30, 9), (12, 12), (5, 40), (33, 32)):
        depth = rng.integers(500, 600, (6, height, width)).astype(np.float32)
        depth[rng.random(depth.shape) < share] = 0.0
        cases.append(torch.from_numpy(depth))
    fills = [
        filled_from_around,
        *(lambda d, r=r, p=p: filled_along_rows(d, r, p) for r in (1, 7, 255) for p in (1, 5)),
    ]
    by_list = [fill(depth) for depth in cases for fill in fills]
    monkeypatch.setattr("saltus.render.holes.on_host", lambda _: False)
    by_image = [fill(depth) for depth in cases for fill in fills]
    for one, other in zip(by_list, by_image, strict=True):
        torch.testing.assert_close(one, other, rtol=0.0, atol=0.0)


@pytest.mark.parametrize("reach", [(1, 1), (3, 1), (5, 5), (2, 0), (0, 3)])
def test_kornia_looks_around_as_arrays_do(reach: tuple[int, int]) -> None:
    rng = np.random.default_rng(3)
    for shape in ((4, 48, 16), (2, 9, 30), (1, 5, 5)):
        values = torch.from_numpy(rng.normal(size=shape).astype(np.float32))
        mask = values > 1.5
        assert torch.equal(
            KorniaWindows().any_around(mask, *reach), ArrayWindows().any_around(mask, *reach)
        )
        for one, other in zip(
            KorniaWindows().range_around(values), ArrayWindows().range_around(values), strict=True
        ):
            assert torch.equal(one, other)
    # A signal that moves keeps it
    assert map_arrays(torch.from_numpy, ArrayWindows()) == ArrayWindows()
