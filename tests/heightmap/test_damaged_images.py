"""Images that lose pixels, and cameras that go blank."""

import numpy as np
import pytest

from saltus.effects.signals import DepthImage
from saltus.heightmap.data.arriving_images import BLANK_FROM_S, ImageDamage

SEEDS = (1, 2, 3)


def images(time_s: float) -> DepthImage:
    return DepthImage(depth=np.full((3, 60, 80), 900, np.uint16), time_s=np.full(3, time_s))


@pytest.mark.parametrize("share", [0.05, 0.2, 0.9])
def test_the_stated_share_of_pixels_is_gone_anew_in_each_image(share: float) -> None:
    damage = ImageDamage(gone=share)
    first, again, later = (damage(images(t), SEEDS).depth for t in (1.0, 1.0, 1.033))
    assert first.dtype == np.uint16
    assert set(np.unique(first)) == {0, 900}
    assert (first == 0).mean(axis=(1, 2)) == pytest.approx(share, abs=0.02)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, later)
    assert not np.array_equal(first[0], first[1])


def test_a_camera_is_blank_once_for_as_long_as_said() -> None:
    damage, times = ImageDamage(blank_s=0.5), np.arange(0.0, 12.0, 0.01)
    blank = np.array([(damage(images(t), SEEDS).depth == 0).all(axis=(1, 2)) for t in times])
    for robot in range(3):
        dark = times[blank[:, robot]]
        assert len(dark) == pytest.approx(50, abs=1)
        assert dark[-1] - dark[0] == pytest.approx(0.5, abs=0.03)
        assert BLANK_FROM_S[0] <= dark[0] <= BLANK_FROM_S[1] + 0.01
