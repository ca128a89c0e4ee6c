from typing import Any

import numpy as np
import pytest

from saltus.effects.image_delivery import CameraLatency
from saltus.heightmap.data.delivery import DELIVERIES, TRAINING, ImageDeliveryModel, draw_delivery
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.settings import DeliveryName

TICKS = 400
TAKEN = np.arange(0, TICKS, 2, dtype=np.int32)


def episode(ticks: int = TICKS, **how: Any) -> Episode:
    taken = TAKEN[ticks > TAKEN]
    images = np.zeros((len(taken), 48, 16), np.uint16)
    rows = np.zeros((ticks, 30), np.float32)
    return Episode(
        terrain="flat", proprioception=rows, height=rows, depth=images, frame_tick=taken, **how
    )


def test_without_faults_images_come_every_20_ms_and_are_50_ms_old() -> None:
    ((frame,), (age_s,), (new,)) = draw_delivery(
        [episode()], ImageDeliveryModel(), np.random.default_rng(0)
    )
    assert list(frame[:9]) == [-1, -1, -1, -1, -1, 0, 0, 1, 1]
    assert np.isinf(age_s[:5]).all()
    np.testing.assert_allclose(
        age_s[5:], np.where(np.arange(5, TICKS) % 2 == 1, 0.05, 0.06), atol=1e-9
    )
    assert list(new[:9]) == [False] * 5 + [True, False, True, False]


def test_with_faults_time_never_runs_backwards_and_nothing_comes_early() -> None:
    lengths = [TICKS, 100, 61] * 20
    delivered = draw_delivery(
        [episode(ticks) for ticks in lengths], TRAINING, np.random.default_rng(0)
    )
    arrived = []
    for ticks, frame, age_s, new in zip(lengths, *delivered, strict=True):
        seen = frame >= 0
        assert (np.diff(frame) >= 0).all()
        assert frame.max() < len(TAKEN[ticks > TAKEN])
        np.testing.assert_array_equal(new[1:], np.diff(frame) > 0)
        assert age_s[seen].min() >= TRAINING.latency_s[0] - 1e-9
        np.testing.assert_allclose(
            age_s[seen], (np.arange(TICKS) - TAKEN[frame])[seen] * 0.01, atol=1e-9
        )
        arrived.append(new.sum() / len(TAKEN[ticks > TAKEN]))
    assert 1.0 - TRAINING.loss - 0.02 < np.mean(arrived) < 0.99


@pytest.mark.parametrize(
    "known", [CameraLatency(latency=0.05), CameraLatency(latency=0.16, jitter=0.01)]
)
@pytest.mark.parametrize("name", DELIVERIES)
def test_images_are_as_late_as_the_name_says_around_what_is_known(
    name: DeliveryName, known: CameraLatency
) -> None:
    """It is used at a whole tick."""
    model = DELIVERIES[name]
    low, high = model.range_s(known)
    assert (
        (low, high) == (0.0, 0.0)
        if name == "at-once"
        else high - low == pytest.approx(np.ptp(model.latency_s))
    )
    jitter_s = 0.0 if name == "at-once" else float(known.jitter)
    delivered = draw_delivery([episode(latency=known)] * 200, model, np.random.default_rng(0))
    arrived = delivered.age_s[delivered.new]
    assert low - jitter_s - 1e-9 <= arrived.min() <= low + 0.01 + 1e-9
    latest = high + jitter_s + model.jitter_s
    assert latest - 0.01 <= arrived.max() <= latest + 0.01 + 1e-9
    if model.loss == model.burst == jitter_s == 0.0:
        held = round(model.range_s(known)[1] / 0.01)
        assert (delivered.frame[:, held:] == np.arange(TICKS - held) // 2).all()


def test_images_of_a_camera_without_latency_come_at_once_beside_others_that_do_not() -> None:
    both = [episode(latency=latency) for latency in (CameraLatency(), CameraLatency(latency=0.05))]
    delivered = draw_delivery(both, TRAINING, np.random.default_rng(0))
    ages = [age_s[new] for age_s, new in zip(delivered.age_s, delivered.new, strict=True)]
    assert ages[0].max() == 0.0
    assert ages[1].min() >= 0.03
