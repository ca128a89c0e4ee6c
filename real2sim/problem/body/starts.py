"""Where windows start: states that agree with the whole window, not with its first instants alone.

A state is measured to within the noise of sensors; a foot that starts a fraction of a millimetre above the ground
lands elsewhere than one that starts on it. How the window goes on tells more of its start, so that what is left unknown
is small enough for its effects to be linear.
"""

from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats
from saltus.real2sim.problem.body.noise import Noise

LARGEST_NORM = 1.5
"""A start that were off by more times as much as starts are in the mean is no error of a start but a gap: there windows
start as measured."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Starts:
    """Errors of the starts of w windows, in standard deviations of d dimensions.

    Attributes:
        likeliest: Shape (w, d).
        root: Of the covariance of what is unknown of them still, shape (w, d, d).
    """

    likeliest: Floats
    root: Floats

    @classmethod
    def of(cls, noise: Noise, claimed: Floats, slopes: Floats, effects: Floats) -> "Starts":
        """The starts that windows tell of, whatever effects the robot has: they are fitted with them, to first order.

        Args:
            noise: Of the sensors.
            claimed: Errors of windows that start as measured, shape (w, blocks, 33).
            slopes: What errors change by with each dimension, shape (d, w, blocks, 33).
            effects: What they change by with an effect of usual size, shape (e, w, blocks, 33).
        """
        error = noise.plain(claimed).reshape(len(claimed), 1, -1)
        slope, effect = (noise.plain(s).reshape(*s.shape[:2], -1).transpose(1, 0, 2) for s in (slopes, effects))
        information = slope @ slope.mT + np.eye(len(slopes))
        rest = effect - (effect @ slope.mT) @ np.linalg.solve(information, slope)  # (w, e, m): what no start imitates
        on_effects = np.sum(rest @ effect.mT, axis=0) + np.eye(len(effects))
        sizes = -np.linalg.solve(on_effects, np.sum(rest @ error.mT, axis=0))
        error = error + sizes.T @ effect
        best = -np.linalg.solve(information, slope @ error.mT)[..., 0]
        norm = np.linalg.norm(best, axis=-1, keepdims=True) / np.sqrt(len(slopes))
        likeliest = np.where(norm <= LARGEST_NORM, best, 0.0)
        return cls(likeliest=likeliest, root=np.linalg.inv(np.linalg.cholesky(information)).mT)

    def drawn(self, count: int, rng: np.random.Generator) -> Floats:
        """Random errors that are as likely as those that are left, shape (count, w, d)."""
        white = rng.standard_normal((count, *self.likeliest.shape))
        return np.asarray(np.einsum("wij,kwj->kwi", self.root, white))
