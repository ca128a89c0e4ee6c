"""Noise of sensors: never white, and in tuning of another colour than in the sealed set."""

import numpy as np
from scipy.signal import lfilter

from benchmarks.hidden_effects.robot import Floats

WARM_UP = 512
"""Samples until a filter has forgotten that it began with nothing."""


def coloured(
    rng: np.random.Generator,
    shape: tuple[int, ...],
    corner_hz: float,
    rate_hz: float,
    tuning: bool,
    *,
    slow_share: float = 0.0,
    slow_hz: float = 1.0,
) -> Floats:
    """Stationary noise of unit variance along the first axis.

    First order up to `corner_hz`, but a share of the variance only up to `slow_hz`: it lasts for a
    good part of a motion. Outside tuning with a weak resonance, as cables and belts have it.
    """
    signal = _first_order(rng, shape, corner_hz, rate_hz)
    if slow_share > 0.0:
        slow = _first_order(rng, shape, slow_hz, rate_hz)
        signal = np.sqrt(1 - slow_share) * signal + np.sqrt(slow_share) * slow
    if not tuning:
        radius, angle = 0.97, rng.uniform(0.2, 0.9) * np.pi
        poles = [1.0, -2 * radius * np.cos(angle), radius**2]
        ring = lfilter([1.0], poles, rng.normal(size=signal.shape), axis=0)
        signal = np.sqrt(0.8) * signal + np.sqrt(0.2) * ring / ring[WARM_UP:].std(axis=0)
    return np.asarray(signal[WARM_UP:], dtype=float)


def _first_order(
    rng: np.random.Generator, shape: tuple[int, ...], corner_hz: float, rate_hz: float
) -> Floats:
    pole = np.exp(-2 * np.pi * corner_hz / rate_hz)
    white = rng.normal(size=(shape[0] + WARM_UP, *shape[1:]))
    white[0] /= np.sqrt(1 - pole**2)  # as if it had gone on for ever
    return np.asarray(np.sqrt(1 - pole**2) * lfilter([1.0], [1.0, -pole], white, axis=0))
