"""Laws of the noise of a stream."""

import numpy as np
import pytest
from scipy.signal import lfilter

from saltus.real2sim.problem.stream_noise import MEAN_S, read_stream_noise

SECONDS = 30.0


def coloured(rate_hz: float, corner_hz: float, ringing: float, at_hz: float) -> np.ndarray:
    """Noise of unit variance in three columns: of first order, with a share that rings."""
    rng = np.random.default_rng(0)
    shape = (round(SECONDS * rate_hz), 3)
    pole = np.exp(-2.0 * np.pi * corner_hz / rate_hz)
    slow = lfilter([1.0], [1.0, -pole], rng.standard_normal(shape), axis=0)
    angle = 2.0 * np.pi * at_hz / rate_hz
    ring = lfilter([1.0], [1.0, -1.94 * np.cos(angle), 0.97**2], rng.standard_normal(shape), axis=0)
    return np.asarray(
        np.sqrt(1.0 - ringing) * slow / slow.std() + np.sqrt(ringing) * ring / ring.std()
    )


@pytest.mark.parametrize("rate_hz", [250.0, 500.0, 1000.0])
@pytest.mark.parametrize("corner_hz", [15.0, 30.0, 100.0])
@pytest.mark.parametrize(("ringing", "at_hz"), [(0.0, 50.0), (0.2, 60.0), (0.2, 100.0)])
def test_noise_of_any_colour_is_read_beside_a_motion(
    rate_hz: float, corner_hz: float, ringing: float, at_hz: float
) -> None:
    noise = coloured(rate_hz, corner_hz, ringing, at_hz)
    time_s = np.arange(len(noise)) / rate_hz
    motion = 100.0 * np.sin(2.0 * np.pi * 1.5 * time_s)[:, None] * np.array([1.0, 0.3, 0.0])
    rows = round(MEAN_S * rate_hz)
    sigma, correlation = read_stream_noise(time_s, noise + motion).of_means(MEAN_S)
    means = noise[: len(noise) // rows * rows].reshape(-1, rows, 3).mean(axis=1)
    assert sigma == pytest.approx(means.std(), rel=0.3)
    assert correlation == pytest.approx(np.mean(means[1:] * means[:-1]) / means.var(), abs=0.25)


def test_what_a_few_impacts_add_is_not_noise() -> None:
    noise = coloured(500.0, 30.0, 0.0, 50.0)
    time_s = np.arange(len(noise)) / 500.0
    struck = noise.copy()
    struck[2000::3000] += 200.0
    quiet, loud = read_stream_noise(time_s, noise), read_stream_noise(time_s, struck)
    assert loud.sigma == pytest.approx(quiet.sigma, rel=0.15)
