import numpy as np
import pytest

from saltus.heightmap.data.delivery import DELIVERIES, TRAINING, DeliveryModel, deliver
from saltus.heightmap.settings import DeliveryName

TICKS = 400
TAKEN = np.arange(0, TICKS, 2, dtype=np.int32)


def test_without_faults_images_come_every_20_ms_and_are_50_ms_old() -> None:
    frame, age_s, new = deliver(TAKEN, TICKS, DeliveryModel(), np.random.default_rng(0))
    assert list(frame[:9]) == [-1, -1, -1, -1, -1, 0, 0, 1, 1]
    assert np.isinf(age_s[:5]).all()
    np.testing.assert_allclose(age_s[5:], np.where(np.arange(5, TICKS) % 2 == 1, 0.05, 0.06), atol=1e-9)
    assert list(new[:9]) == [False] * 5 + [True, False, True, False]


@pytest.mark.parametrize("seed", range(20))
def test_with_faults_time_never_runs_backwards_and_nothing_comes_early(seed: int) -> None:
    frame, age_s, new = deliver(TAKEN, TICKS, TRAINING, np.random.default_rng(seed))
    seen = frame >= 0
    assert (np.diff(frame) >= 0).all()
    np.testing.assert_array_equal(new[1:], np.diff(frame) > 0)
    assert age_s[seen].min() >= TRAINING.latency_s[0] - 1e-9
    np.testing.assert_allclose(age_s[seen], (np.arange(TICKS) - TAKEN[frame])[seen] * 0.01, atol=1e-9)


@pytest.mark.parametrize("name", DELIVERIES)
def test_images_are_as_late_as_the_name_says_until_the_next_one(name: DeliveryName) -> None:
    model = DELIVERIES[name]
    for seed in range(20):
        frame, age_s, new = deliver(TAKEN, TICKS, model, np.random.default_rng(seed))
        arrived = age_s[new]
        assert arrived.min() >= model.latency_s[0] - 1e-9
        assert arrived.max() <= model.latency_s[1] + model.jitter_s + 0.01 + 1e-9  # it is used at a whole tick
        if model.loss == model.burst == 0.0:
            held = round(model.latency_s[1] / 0.01)
            np.testing.assert_array_equal(frame[held:], np.arange(TICKS - held) // 2)
