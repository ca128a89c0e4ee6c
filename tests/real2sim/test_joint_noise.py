"""Laws of the noise of joints."""

import numpy as np
import pytest
from scipy.signal import lfilter

from saltus.real2sim.problem.joints.noise import PIECE, learned_whitening
from saltus.real2sim.problem.joints.problem import SAMPLE_S

SAMPLES, JOINTS = 1875, 12
"""Samples of a log of 30 s, and signals with noise of one law."""


def first_order(rng: np.random.Generator, corner_hz: float) -> np.ndarray:
    """Noise of unit variance, shape (SAMPLES, JOINTS)."""
    pole = np.exp(-2.0 * np.pi * corner_hz * SAMPLE_S)
    white = rng.standard_normal((SAMPLES, JOINTS))
    white[0] /= np.sqrt(1.0 - pole**2)  # as if it had gone on for ever
    return np.asarray(np.sqrt(1.0 - pole**2) * lfilter([1.0], [1.0, -pole], white, axis=0))


def noise(rng: np.random.Generator) -> np.ndarray:
    """Noise of which three tenths of the variance last for a good part of a motion."""
    return np.sqrt(0.7) * first_order(rng, 25.0) + np.sqrt(0.3) * first_order(rng, 1.5)


def swing(rng: np.random.Generator, size: float) -> np.ndarray:
    """Motion that is no curve of few coefficients over a second, but over a quarter of one."""
    turns = rng.uniform(1.0, 3.0, JOINTS) * SAMPLE_S * np.arange(SAMPLES)[:, None]
    return np.asarray(size * np.sin(2.0 * np.pi * (turns + rng.uniform(size=JOINTS))))


def power_of_noise(rng: np.random.Generator, repeated: float, claimed: float) -> np.ndarray:
    """Mean square of whitened noise of each joint; 1 is right.

    Repeats and what the claimed model leaves hold motions of these sizes besides.
    """
    apart = (noise(rng) - noise(rng)) / np.sqrt(2.0) + swing(rng, repeated)
    repeats = apart[: 34 * PIECE].reshape(34, PIECE, JOINTS)
    whitening = learned_whitening(
        [repeats],
        noise(rng) + swing(rng, claimed),
        np.zeros(JOINTS),
        np.zeros(JOINTS, dtype=bool),
    )
    white = whitening.white(noise(rng)[..., None], np.array([0]))
    return np.asarray(np.mean(white[..., 0] ** 2, axis=0))


@pytest.mark.sample(16)
@pytest.mark.parametrize("claimed", [0.0, 2.0, 4.0])
@pytest.mark.parametrize("seed", range(12))
def test_repeats_tell_slow_noise_whatever_the_claimed_model_leaves(
    seed: int, claimed: float
) -> None:
    power = power_of_noise(np.random.default_rng(seed), 0.0, claimed)
    assert np.all((power > 0.6) & (power < 1.5))


@pytest.mark.parametrize("seed", range(4))
def test_noise_is_read_beside_motions_that_differ_from_repeat_to_repeat(seed: int) -> None:
    assert np.all(power_of_noise(np.random.default_rng(seed), 20.0, 20.0) > 0.5)
