"""How good the cameras of training are: what differs from one stereo camera to the next.

Where a camera sits (`saltus.heightmap.data.randomisation`) and how late its images come
(`saltus.heightmap.data.delivery`) is drawn by whoever moves robots.
"""

from dataclasses import replace

import numpy as np

from saltus.arrays import Floats
from saltus.render.stereo.camera import StereoConfig

STRENGTH = (0.4, 2.0)
"""Factor on noise, holes and flying pixels: sub-pixel noise is 0.03 px at best, 0.08 px in
practice, and worse on poor texture (Intel on the D4xx)."""
# Draws a camera, before its strength: with them a seed gives the cameras that earlier versions drew
SKIPPED = 13


def drawn_cameras(count: int, rng: np.random.Generator, usual: StereoConfig) -> StereoConfig:
    """The errors of `count` cameras of different quality."""
    rng.uniform(size=(SKIPPED, count))
    return of_strength(rng.uniform(*STRENGTH, count), usual)


def of_strength(strength: Floats, usual: StereoConfig) -> StereoConfig:
    """The errors of cameras, each as many times those of a usual one as its strength says,
    shape (count,).
    """

    def share(fraction: object) -> Floats:
        return np.minimum(np.asarray(fraction) * strength, 1.0)

    return replace(
        usual,
        disparity_noise=replace(
            usual.disparity_noise, sigma=np.asarray(usual.disparity_noise.sigma) * strength
        ),
        edge_holes=replace(usual.edge_holes, fraction=share(usual.edge_holes.fraction)),
        weak_signal=replace(
            usual.weak_signal, reach=np.asarray(usual.weak_signal.reach) / np.sqrt(strength)
        ),
        flying_pixels=replace(usual.flying_pixels, fraction=share(usual.flying_pixels.fraction)),
    )
