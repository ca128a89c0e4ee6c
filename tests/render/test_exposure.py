"""What the camera process exposes: true depth, or a stereo camera's."""

import numpy as np
from samples import ROBOT, level_truth

from saltus.arrays import Floats
from saltus.config import TerrainConfig
from saltus.depth import Intrinsics, depth_in_millimetres, model_image
from saltus.depth_camera import SHIPPED
from saltus.render.backends import make_renderer
from saltus.render.camera import RobotCamera
from saltus.render.exposure import PerfectExposure, StereoExposure
from saltus.terrain.curriculum import make_terrain
from saltus.wire.messages import GroundTruth

TERRAIN = make_terrain(TerrainConfig(terrain="stairs", rise_m=0.15))


def truth(step: int) -> GroundTruth:
    return level_truth(step, 0.6 + 0.01 * step, ROBOT.stand_height)


def seen(depth: Floats, camera: Intrinsics) -> tuple[Floats, Floats]:
    """Depth [m] and validity of the model's image."""
    near, valid = model_image(depth_in_millimetres(depth), camera)
    return 3.0 * near, valid > 0.0


def test_the_model_sees_the_same_through_both_but_for_the_errors_of_the_camera() -> None:
    perfect = PerfectExposure(make_renderer("embree", TERRAIN, RobotCamera.on(ROBOT)))
    stereo = StereoExposure(TERRAIN, ROBOT, SHIPPED["d435i"], np.random.default_rng(0))
    for step in range(0, 40, 2):
        true_depth, _ = seen(perfect.expose(truth(step)), perfect.intrinsics)
        depth, valid = seen(stereo.expose(truth(step)), stereo.intrinsics)
        assert valid.mean() > 0.9
        error = np.abs(depth - true_depth)[valid]
        # sigma of one pixel of the sensor at 1.5 m is 17 mm, of which pooling leaves a part
        assert np.median(error) < 0.01
        assert np.median(error) > 0.0003


def test_a_seed_gives_the_same_errors_again_and_another_does_not() -> None:
    a, b, c = (
        StereoExposure(TERRAIN, ROBOT, SHIPPED["d435i"], np.random.default_rng(seed))
        for seed in (1, 1, 2)
    )
    for step in range(0, 6, 2):
        first, second, other = a.expose(truth(step)), b.expose(truth(step)), c.expose(truth(step))
        np.testing.assert_array_equal(first, second)
        assert (first != other).mean() > 0.3
