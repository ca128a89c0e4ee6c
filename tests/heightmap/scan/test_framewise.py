"""The rival that sees single images: each as if it were the first, fused by what is surer."""

import numpy as np
import torch

from saltus.heightmap.scan.elevation import WIDEST, new_map
from saltus.heightmap.scan.network_inputs import MapHeights, remember_told
from saltus.heightmap.scan.settings import MapSettings
from saltus.heightmap.scan.training.examples import with_image
from saltus.heightmap.scan.training.flights import next_image
from saltus.heightmap.scan.training.framewise import heights_kept, of_image

SETTINGS = MapSettings(cells=16)


def test_an_image_alone_is_what_it_would_be_as_the_first(fly, draws):
    flight, flights = fly(3)
    state, like = new_map(3, SETTINGS, flight.ground.height), flight.ground.height
    for _ in range(3):
        shot = next_image(flight, flights, draws)
        state, _, _ = with_image(state, shot.measured, shot.now_s, SETTINGS)
    _, inputs, around = of_image(state, shot.measured, shot.now_s, SETTINGS)
    first = new_map(3, SETTINGS, like)._replace(correction=state.correction)
    _, expected, _ = with_image(first, shot.measured, shot.now_s, SETTINGS)
    torch.testing.assert_close(inputs.measured, expected.measured)
    torch.testing.assert_close(inputs.filled, expected.filled)
    torch.testing.assert_close(around.base, shot.measured.now.position + state.correction)


def test_the_surer_height_is_kept_and_gets_less_sure():
    rng = np.random.default_rng(0)
    state, shape = new_map(2, SETTINGS, np.zeros(1)), (2, SETTINGS.side, SETTINGS.side)
    state = remember_told(state, MapHeights(rng.normal(size=shape), rng.uniform(0.01, 0.2, shape)))
    new = MapHeights(rng.normal(size=shape), rng.uniform(0.01, 0.2, shape))
    found = heights_kept(state, state.corner, new, np.full(2, 0.1), SETTINGS)
    is_new = found.height == new.height
    np.testing.assert_array_equal(found.height, np.where(is_new, new.height, state.told))
    assert (found.half_width <= new.half_width).all()
    assert (found.half_width[~is_new] > state.told_width[~is_new]).all()
    assert is_new[new.half_width < state.told_width].all()


def test_an_image_of_another_window_is_put_in_its_place():
    shape = (1, SETTINGS.side, SETTINGS.side)
    height = np.arange(SETTINGS.side**2, dtype=float).reshape(shape)
    state = new_map(1, SETTINGS, np.zeros(1))
    found = heights_kept(
        state,
        state.corner + np.array([[1, -2]]),
        MapHeights(height, np.full(shape, 0.1)),
        np.zeros(1),
        SETTINGS,
    )
    by, told = SETTINGS.sub, found.half_width < WIDEST
    np.testing.assert_array_equal(found.height[0, by:, : -2 * by], height[0, :-by, 2 * by :])
    assert told.sum() == (SETTINGS.side - by) * (SETTINGS.side - 2 * by)
