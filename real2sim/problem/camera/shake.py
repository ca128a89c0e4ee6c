"""Errors of the measured pose: noise that all pixels of an image share."""

from dataclasses import dataclass, replace

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.real2sim.problem.camera.candidates import CameraEffects
from saltus.real2sim.problem.camera.model import DepthModel

STEP = 1e-4  # m and rad, of the derivatives: moves a pixel by far less than its width


@dataclass(frozen=True, kw_only=True, eq=False)
class Shake:
    """Whitens images whose pixels have noise of their own and noise that they share.

    With A the shared part, one column for each error of the pose in units of a pixel's noise, the covariance is
    I + A A'. Its inverse root only turns down what lies in the columns' space: (I + A A')^-1/2 = I - U K U'.
    """

    basis: Floats
    """U, shape (images, pixels, 6)."""
    cut: Floats
    """Diagonal of K, shape (images, 6)."""

    def whitened(self, residual: Floats) -> Floats:
        """Residuals in units of the pixels' noise, 0 where there is no pixel; shape (images, pixels)."""
        along = np.einsum("fpk,fp->fk", self.basis, residual)
        return np.asarray(residual - np.einsum("fpk,fk->fp", self.basis, self.cut * along))


def shake_of(model: DepthModel, view: CameraEffects, kept: Indices, sigma: Floats) -> Shake:
    """The shared noise of the images `kept` of `model` from this view; its motion knows how well it was measured.

    `sigma` is the noise of each pixel [m], infinite where it is not looked at, shape (kept, pixels).
    """
    still = model.predict(view, kept)
    columns = []
    for axis in range(6):
        step = np.zeros(6)
        step[axis] = STEP
        moved = replace(model, shift_m=step[:3], turn_rad=step[3:]).predict(view, kept)
        deviation = model.motion.noise_m if axis < 3 else model.motion.noise_rad
        columns.append((moved - still) * (deviation / STEP) / sigma)
    basis, size, _ = np.linalg.svd(np.stack(columns, axis=-1), full_matrices=False)
    return Shake(basis=basis, cut=1.0 - 1.0 / np.sqrt(1.0 + size**2))
