"""Scatter of gains and estimates when residuals are not perfectly white."""

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.real2sim.search.quadratic import Quadratic
from saltus.real2sim.search.split import TEST, Mask, Split

RESAMPLES = 400
"""With this number the 5 and 95 % quantiles scatter by about a tenth of the standard deviation."""


def held_out_gains(before: Floats, after: Floats, split: Split) -> Floats:
    """Gain [nats] of each chunk outside the test, from costs of shape (blocks, chunks)."""
    return np.asarray(0.5 * (before - after).sum(axis=0)[split.fold != TEST])


def spread(gains: Floats, rng: np.random.Generator) -> tuple[float, tuple[float, float]]:
    """Standard deviation and 90 % interval of the sum of gains, from chunks drawn with replacement."""
    draws = rng.integers(len(gains), size=(RESAMPLES, len(gains)))
    totals = gains[draws].sum(axis=1)
    low, high = np.quantile(totals, (0.05, 0.95))
    return float(totals.std()), (float(low), float(high))


def downside(gains: Floats) -> float:
    """Standard deviation of the sum of gains, estimated from the losses.

    A true effect may show in a few chunks only: gains then scatter although their sum is certain. A sum is uncertain if
    many chunks contribute losses; if everything were chance, losses would make half of the scatter.
    """
    return float(np.sqrt(2.0 * np.sum(np.minimum(gains, 0.0) ** 2)))


def covariance(quadratic: Quadratic, block: int, free: Mask) -> Floats:
    """Covariance of the fitted unknowns for residuals of any colour, shape (k, k); 0 where not free.

    The sandwich estimate H^-1 (sum of g g^T over chunks) H^-1, nowhere smaller than that of white noise.
    """
    seen = quadratic.split.fold != TEST
    hessian = quadratic.information(block)
    active = _known(hessian, free)
    part = hessian[np.ix_(active, active)]
    scores = quadratic.gradient[block][seen][:, active]
    scores = scores - scores.mean(axis=0)
    inverse = np.linalg.pinv(part, hermitian=True)
    sandwich = inverse @ (scores.T @ scores) @ inverse * len(scores) / max(1, len(scores) - len(active))
    missing = np.maximum(0.0, np.diag(inverse) - np.diag(sandwich))
    full = np.zeros_like(hessian)
    full[np.ix_(active, active)] = sandwich + np.diag(missing)
    return full


def dispersion(quadratic: Quadratic, free: Mask) -> float:
    """Ratio of the variance of scores to that of white noise of unit variance, at least 1.

    Gains divided by it are as those of independent samples.
    """
    seen = quadratic.split.fold != TEST
    total, count = 0.0, 0
    for block in range(len(quadratic.cost)):
        hessian = quadratic.information(block)
        active = _known(hessian, free)
        scores = quadratic.gradient[block][seen][:, active]
        scores = scores - scores.mean(axis=0)
        power = np.sum(scores**2, axis=0) / np.diag(hessian)[active]
        total, count = total + float(power.sum()), count + len(active)
    return max(1.0, total / count) if count else 1.0


def _known(hessian: Floats, free: Mask) -> Indices:
    """Free unknowns that some residual depends on."""
    diagonal = np.diag(hessian)
    return np.flatnonzero(free & (diagonal > 1e-12 * max(float(diagonal.max(initial=0.0)), 1e-300)))
