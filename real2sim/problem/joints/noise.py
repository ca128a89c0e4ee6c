"""Noise of the signals of joints: its level and colour, and what makes it white.

Noise is what is left where the same is commanded twice, or else what is no smooth curve over a
fraction of a second where the joints are quietest.
"""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from saltus.arrays import Floats, Indices
from saltus.effects.effect import map_arrays
from saltus.real2sim.problem.problem import LogSegment

ORDER = 2
"""Order of the autoregression: it holds a corner frequency and what an average adds to it."""
PIECE = 16
"""Samples of a piece whose energy is looked at: 0.25 s."""
LONG, CURVE = 64, 4
"""Samples of the pieces, 1 s, and coefficients of the smooth curve that is taken from each where
nothing is repeated: what effects leave in a slow motion goes, and of noise little more than a
sixteenth."""
SAME_COMMAND = 1e-3  # rad RMS: repeats are sent the same commands up to rounding
QUIET_SHARE = 1.0 / 3.0
"""Share of the pieces that is taken to be noise alone, those with least energy: the others also
hold what effects do."""
MOST = 0.7
"""Share of the pieces that counts where most are noise: repeats often differ in how they begin,
over a piece or two."""
FAR_LESS = 0.5
"""Ratio of the spread of short pieces to that of long ones, below which long ones hold more than
noise: that of noise, however slow, is at least 0.55 (first-order noise with corners down to
0.3 Hz)."""
CLEARLY_LESS = 0.8
"""Ratio of two estimates of a spread, below which they are not of the same noise: from a log of
30 s such estimates differ by less."""
LARGEST_POLE = 0.98
"""Largest pole of the autoregression, which never believes in noise that lasts longer than 1 s."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointWhitening:
    """Whitens residuals of joints by an autoregression for each signal."""

    weights: Floats
    """Weights of the last `ORDER` samples, shape (ORDER, ...)."""
    innovation: Floats
    """Standard deviation of what they do not tell, shape (...)."""
    spread: Floats
    """Standard deviation of the noise, shape (...)."""

    def white(self, residuals: Floats, starts: Indices) -> Floats:
        """Whitens residuals, shape (samples, ..., sets).

        The predecessors of the samples `starts` are missing: they are divided by the spread alone.
        """
        out = residuals / self.innovation[..., None]
        for i in range(ORDER):
            out[i + 1 :] -= (self.weights[i] / self.innovation)[..., None] * residuals[: -i - 1]
        fresh = np.unique(np.concatenate([starts + i for i in range(ORDER)]))
        fresh = fresh[fresh < len(residuals)]
        out[fresh] = residuals[fresh] / self.spread[..., None]
        return out


def whitening(pieces: Floats, floor: Floats, most_count: NDArray[np.bool_]) -> JointWhitening:
    """The autoregression of pieces of noise (pieces, PIECE, ...), of which the quietest count.

    `floor` is the smallest standard deviation to believe in, shape (...); where `most_count`, most
    pieces count.
    """
    energy = np.mean(pieces**2, axis=1)
    count = max(1, int(np.ceil(QUIET_SHARE * len(pieces))))
    order = np.argsort(energy, axis=0)
    quiet = np.take_along_axis(pieces, order[:count][:, None], axis=0)
    many = max(1, int(MOST * len(pieces)))
    most = np.take_along_axis(pieces, order[:many][:, None], axis=0)
    lags = [np.where(most_count, _lag(most, i), _lag(quiet, i)) for i in range(ORDER + 1)]
    # the quietest of many pieces have less energy than all have
    scale = np.where(most_count, _quietest(len(pieces), many), _quietest(len(pieces), count))
    variance = np.maximum(lags[0] / scale, floor**2)
    first, second = (lag / np.maximum(lags[0], 1e-300) for lag in lags[1:])
    first = np.clip(first, -LARGEST_POLE, LARGEST_POLE)
    determinant = 1.0 - first**2
    weights = np.stack([first * (1.0 - second), second - first**2]) / determinant
    weights[1] = np.clip(weights[1], -LARGEST_POLE, LARGEST_POLE)
    known = weights[0] * first + weights[1] * second
    innovation = np.sqrt(variance * np.clip(1.0 - known, 1.0 - LARGEST_POLE, 1.0))
    return JointWhitening(weights=weights, innovation=innovation, spread=np.sqrt(variance))


def learned_whitening(
    repeats: list[Floats], claimed: Floats, floor: Floats, is_coarse: NDArray[np.bool_]
) -> JointWhitening:
    """The whitening of repeats, or that of what is not smooth where it is clearly quieter.

    Repeats that differ by more than noise, e.g. because a battery emptied, overstate it.

    Args:
        repeats: Pieces of `noise_of_repeats`; none where nothing is commanded twice.
        claimed: Measured minus simulated without effects, shape (samples, ...).
        floor: Smallest standard deviation to believe in, shape (...).
        is_coarse: Signals of an encoder that hunts between two steps, differently each time, shape
            (...): there most pieces are noise, and repeats are believed at any rate.
    """
    rest, is_short = _smooth_left_out(claimed)
    rough = whitening(rest, floor, is_coarse)
    if not repeats:
        return rough
    known = whitening(np.concatenate(repeats), floor, is_coarse)
    ratio = np.where(is_short, FAR_LESS, CLEARLY_LESS)  # short pieces lack slow noise
    taken = (rough.spread < ratio * known.spread) & ~is_coarse
    found: JointWhitening = map_arrays(lambda one, other: np.where(taken, one, other), rough, known)
    return found


def _lag(pieces: Floats, lag: int) -> Floats:
    return np.asarray(np.mean(pieces[:, lag:] * pieces[:, : PIECE - lag], axis=(0, 1)))


def _quietest(pieces: int, count: int) -> float:
    """Mean energy of the `count` quietest of `pieces` pieces of white noise, over that of all.

    The energy of a piece of n samples has a chi-square distribution of n degrees of freedom.
    """
    return float(np.mean(chi2.ppf((np.arange(count) + 0.5) / pieces, PIECE)) / PIECE)


def _smooth_left_out(samples: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Pieces of a signal, shape (samples, ...), without their smooth parts, shape (pieces, PIECE,
    ...), and where these were taken from short pieces, shape (...).

    Where a second at a time leaves far more than a quarter of a second at a time, it is no noise: a
    robot that never rests, of which the claimed model says little.
    """
    long, short = (
        _rest(samples, length) for length in (min(LONG, len(samples) // PIECE * PIECE), PIECE)
    )
    short = short[: len(long)]
    quiet = [
        np.quantile(np.mean(pieces**2, axis=1), QUIET_SHARE, axis=0) for pieces in (long, short)
    ]
    is_short = quiet[1] < FAR_LESS**2 * quiet[0]
    return np.where(is_short, short, long), is_short


def _rest(samples: Floats, length: int) -> Floats:
    count = len(samples) // length
    pieces = samples[: count * length].reshape(count, length, *samples.shape[1:])
    powers = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, length), CURVE - 1)
    smooth = powers @ np.linalg.pinv(powers)
    rest = (pieces - np.einsum("ij,pj...->pi...", smooth, pieces)) * np.sqrt(
        length / (length - CURVE)
    )
    return np.asarray(rest.reshape(-1, PIECE, *samples.shape[1:]))


def noise_of_repeats(
    time_s: Floats, rows: Floats, commands: Floats, segments: tuple[LogSegment, ...], averaged: int
) -> list[Floats]:
    """Pieces of noise from what is commanded twice:
    half the variance of the difference is that of one.

    Args:
        time_s: Of the rows, shape (rows,).
        rows: Signals, shape (rows, ...).
        commands: Shape (rows, joints).
        segments: Those of one condition are compared with the next of it.
        averaged: Rows that make a sample.

    Returns:
        Each of shape (pieces, PIECE, ...), in samples.
    """
    found = []
    period = float(np.median(np.diff(time_s)))
    for condition in dict.fromkeys(segment.condition for segment in segments):
        members = [s for s in segments if s.condition == condition]
        for one, other in itertools.pairwise(members):
            a, b = (int(np.searchsorted(time_s, s.start_s - 0.25 * period)) for s in (one, other))
            length = min(one.end_s - one.start_s, other.end_s - other.start_s)
            pieces = min(int(length / period), len(rows) - max(a, b)) // (averaged * PIECE)
            count = pieces * averaged * PIECE
            apart = commands[a : a + count] - commands[b : b + count]
            if pieces and np.sqrt(np.mean(apart**2)) < SAME_COMMAND:
                noise = (rows[a : a + count] - rows[b : b + count]) / np.sqrt(2.0)
                found.append(noise.reshape(pieces, PIECE, averaged, *rows.shape[1:]).mean(axis=2))
    return found
