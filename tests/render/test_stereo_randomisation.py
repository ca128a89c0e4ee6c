"""Cameras that differ from robot to robot."""

import numpy as np

from saltus.render.randomisation import STRENGTH, drawn_cameras, of_strength
from saltus.render.stereo.camera import StereoConfig

COUNT = 400


def test_draws_fill_their_distribution_and_a_seed_repeats_them() -> None:
    sigma, again = (
        np.asarray(
            drawn_cameras(COUNT, np.random.default_rng(3), StereoConfig()).disparity_noise.sigma
        )
        for _ in range(2)
    )
    np.testing.assert_array_equal(sigma, again)
    strength = sigma / 0.08
    assert STRENGTH[0] <= strength.min() < 0.5 < 1.9 < strength.max() <= STRENGTH[1]


def test_a_stronger_camera_errs_more_and_one_of_strength_1_is_the_usual_one() -> None:
    usual, drawn = StereoConfig(), of_strength(np.array([1.0, 2.0, 10.0]), StereoConfig())
    for effect, name in (
        ("disparity_noise", "sigma"),
        ("edge_holes", "fraction"),
        ("flying_pixels", "fraction"),
    ):
        values = getattr(getattr(drawn, effect), name)
        assert values[0] == getattr(getattr(usual, effect), name) < values[1] < values[2]
    assert np.max(drawn.edge_holes.fraction) <= 1.0
    np.testing.assert_allclose(drawn.weak_signal.reach, 10.0 / np.sqrt([1.0, 2.0, 10.0]))
