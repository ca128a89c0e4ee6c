"""Where and when a camera seems to look that is far from its claim: too far for slopes at the claim to lead there."""

from itertools import product

import numpy as np
from scipy.optimize import minimize

from saltus.arrays import Floats, Indices
from saltus.real2sim.problem.camera.candidates import CameraEffects
from saltus.real2sim.problem.camera.model import DepthModel

GROSS = 0.5  # relative error of depth: another surface
WHOLE = 0.95  # of an end of the range: noise of 1 % of depth is not cut there
FAR = 0.03
"""Mean relative error of depth from which a camera is far off: a pitch of 1 degree on level ground."""
LEFT = 0.1
"""Share of that error which an aligned camera may leave: more is something else, which it would only imitate."""
FRAMES = 60
"""Images that are looked at."""
SCALE = 0.05
"""Unit of the search [s, rad, m]: a latency, a pitch and a height that change the depth about as much."""
PITCHES, HEIGHTS, LATENCIES = np.linspace(-4.0, 4.0, 17), (-2.0, -1.0, 0.0, 1.0, 2.0), (-1.0, 1.0, 2.0, 3.0, 4.0, 5.0)
"""First points, in that unit: the bounds of what the problem searches."""
EVALUATIONS = 250


def misfit(predicted: Floats, measured: Floats, range_m: float) -> float:
    """Mean relative error, at most `GROSS`; a pixel that is invalid should be out of range, but may be a hole."""
    valid = measured > 0.0
    error = np.minimum(np.abs(predicted - measured) / np.where(valid, measured, 1.0), GROSS)
    return float(np.mean(np.where(valid, error, 0.1 * GROSS * (predicted < WHOLE * range_m))))


def aligned(model: DepthModel, kept: Indices, measured: Floats) -> CameraEffects:
    """Latency, pitch and height at which the scene agrees with the images; as claimed where it is not far off there.

    Edges need not lie where they are claimed: all pixels count, and none for more than another surface does.
    """
    some = np.arange(len(kept))[:: max(1, len(kept) // FRAMES)]

    def cost(point: Floats | tuple[float, ...]) -> float:
        predicted = model.predict(_effects(point), kept[some])
        return misfit(predicted, measured[some], model.camera.range_m)

    claimed = cost((0.0, 0.0, 0.0))
    if claimed <= FAR:
        return CameraEffects()
    start = min(((0.0, pitch, height) for pitch, height in product(PITCHES, HEIGHTS)), key=cost)
    start = min((start, *((latency, *start[1:]) for latency in LATENCIES)), key=cost)
    simplex = np.vstack([start, np.asarray(start) + 0.3 * np.eye(3)])
    best = minimize(
        cost,
        start,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": EVALUATIONS, "xatol": 1e-3, "fatol": 1e-6},
    )
    return _effects(best.x) if best.fun < LEFT * claimed else CameraEffects()


def _effects(point: Floats | tuple[float, ...]) -> CameraEffects:
    latency, pitch, height = (SCALE * float(value) for value in point)
    return CameraEffects(camera_latency=latency, camera_pitch=pitch, camera_height=height)
