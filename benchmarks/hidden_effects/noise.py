"""Noise of sensors: never white, and in tuning of another colour than in the sealed set."""

import numpy as np
from scipy.signal import lfilter

from benchmarks.hidden_effects.robot import Floats


def coloured(
    rng: np.random.Generator, shape: tuple[int, ...], corner_hz: float, rate_hz: float, tuning: bool
) -> Floats:
    """Stationary noise of unit variance along the first axis.

    First order up to `corner_hz` in tuning; otherwise that plus a weak resonance, as cables and belts have it.
    """
    warm = 512
    white = rng.normal(size=(shape[0] + warm, *shape[1:]))
    pole = np.exp(-2 * np.pi * corner_hz / rate_hz)
    signal = np.sqrt(1 - pole**2) * lfilter([1.0], [1.0, -pole], white, axis=0)
    if not tuning:
        radius, angle = 0.97, rng.uniform(0.2, 0.9) * np.pi
        poles = [1.0, -2 * radius * np.cos(angle), radius**2]
        ring = lfilter([1.0], poles, rng.normal(size=white.shape), axis=0)
        signal = np.sqrt(0.8) * signal + np.sqrt(0.2) * ring / ring[warm:].std(axis=0)
    return np.asarray(signal[warm:], dtype=float)
