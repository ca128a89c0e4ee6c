"""Depth that a camera with given effects measures at some pixels of all images of a log."""

from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from saltus.arrays import Floats, Indices
from saltus.real2sim.problem.camera.candidates import CameraEffects
from saltus.real2sim.problem.camera.rays import BaseMotion, ClaimedCamera, VisibleScene
from saltus.rotations import skew


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthModel:
    """Casts the rays of a claimed camera, moved by effects, from the measured pose of the base."""

    scene: VisibleScene
    camera: ClaimedCamera
    motion: BaseMotion
    stamp_s: Floats
    """Exposure plus total latency of all images [s], shape (images,)."""
    jitter_s: Floats
    """Part of `stamp_s` that may be scatter of the arrival [s], shape (images,)."""
    tangents: Floats
    """Tangents of the pixels, camera frame, shape (3, pixels)."""
    shown: Indices
    """Images in the order in which a temporal filter has seen them; repeats may be among them.
    Shape (filtered,)."""
    is_hole: NDArray[np.bool_] | None = None
    """Invalid pixels of those, shape (filtered, pixels): there a filter begins anew."""
    shift_m: Floats = field(default_factory=lambda: np.zeros(3))
    """Error of the measured position, world frame, shape (3,)."""
    turn_rad: Floats = field(default_factory=lambda: np.zeros(3))
    """Small error of the measured rotation, about the axes of the base, shape (3,)."""

    def predict(self, effects: CameraEffects, kept: Indices) -> Floats:
        """Mean depth [m] of the images `kept`, shape (kept, pixels); what sees nothing is far.

        A temporal filter has seen all images before, so that with one they are all predicted.
        """
        if effects.temporal_smear <= 0.0:
            return self._image(effects, kept)
        depth = self._image(effects, np.arange(len(self.stamp_s)))[self.shown]
        alpha = 1.0 / (1.0 + effects.temporal_smear)
        for k in range(1, len(depth)):
            mixed = alpha * depth[k] + (1.0 - alpha) * depth[k - 1]
            if self.is_hole is not None:
                mixed = np.where(self.is_hole[k] | self.is_hole[k - 1], depth[k], mixed)
            depth[k] = mixed
        return np.asarray(depth[np.searchsorted(self.shown, kept)])

    def noise_share(self, effects: CameraEffects, kept: Indices) -> Floats:
        """Share of the variance of white noise that a temporal filter leaves, shape (kept, pixels).

        Of weight alpha it leaves alpha / (2 - alpha) in the end; after a hole it begins anew.
        """
        if effects.temporal_smear <= 0.0:
            return np.ones((len(kept), self.tangents.shape[1]))
        alpha = 1.0 / (1.0 + effects.temporal_smear)
        share = np.ones((len(self.shown), self.tangents.shape[1]))
        for k in range(1, len(share)):
            mixed = alpha**2 + (1.0 - alpha) ** 2 * share[k - 1]
            share[k] = (
                mixed
                if self.is_hole is None
                else np.where(self.is_hole[k] | self.is_hole[k - 1], 1.0, mixed)
            )
        return np.asarray(share[np.searchsorted(self.shown, kept)])

    def rays(self, effects: CameraEffects, kept: Indices) -> tuple[Floats, Floats]:
        """Origins [m], shape (kept, 3), and directions,
        shape (kept, 3, pixels), in the world frame.
        """
        exposed_s = self.stamp_s[kept] - effects.arrival_jitter * self.jitter_s[kept]
        exposed_s = exposed_s - self.camera.latency_s - effects.camera_latency
        position, rotation = self.motion.at(exposed_s)
        position, rotation = position + self.shift_m, rotation @ (np.eye(3) + skew(self.turn_rad))
        claimed = self.camera.mount
        raised = claimed.position + np.array([0.0, 0.0, effects.camera_height])
        mount = replace(claimed, position=raised, pitch=claimed.pitch + effects.camera_pitch)
        wider = 1.0 + effects.camera_fov
        looks = mount.rotation @ (self.tangents * np.array([[wider], [wider], [1.0]]))
        return position + rotation @ mount.position, rotation @ looks

    def _image(self, effects: CameraEffects, kept: Indices) -> Floats:
        depth = self.scene.depth(*self.rays(effects, kept))
        depth = np.minimum(
            (1.0 + effects.depth_scale) * depth + effects.depth_bias, self.camera.range_m
        )
        if effects.range_clip > 0.0:
            depth = depth - effects.range_clip * np.maximum(depth - effects.clip_m, 0.0)
        return depth


STEP = 1e-4  # m and rad, of the derivatives: moves a pixel by far less than its width


@dataclass(frozen=True, kw_only=True, eq=False)
class PixelWhitening:
    """Whitens images whose pixels have noise of their own and noise that they share:
    errors of the measured pose.

    With A the shared part, one column for each error of the pose in units of a pixel's noise, the
    covariance is I + A A'. Its inverse root only turns down what lies in the columns' space: (I + A
    A')^-1/2 = I - U K U'.
    """

    basis: Floats
    """U, shape (images, pixels, 6)."""
    cut: Floats
    """Diagonal of K, shape (images, 6)."""

    def whitened(self, residual: Floats) -> Floats:
        """Residuals in units of the pixels' noise, 0 where there is no pixel.

        Shape (images, pixels).
        """
        along = np.einsum("fpk,fp->fk", self.basis, residual)
        return np.asarray(residual - np.einsum("fpk,fk->fp", self.basis, self.cut * along))


def shake_of(
    model: DepthModel, view: CameraEffects, kept: Indices, sigma: Floats
) -> PixelWhitening:
    """The shared noise of the images `kept` of `model` from this view.

    Its motion knows how well it was measured.

    `sigma` is the noise of each pixel [m], infinite where it is not looked at, shape (kept,
    pixels).
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
    return PixelWhitening(basis=basis, cut=1.0 - 1.0 / np.sqrt(1.0 + size**2))


GROSS = 0.5  # relative error of depth: another surface
WHOLE = 0.95  # of an end of the range: noise of 1 % of depth is not cut there
FAR = 0.03
"""Mean relative error of depth from which a camera is far off: a pitch of 1 degree on level
ground."""
LEFT = 0.1
"""Share of that error which an aligned camera may leave: more is something else, which it would
only imitate."""
FRAMES = 60
"""Images that are looked at."""
SCALE = 0.05
"""Unit of the search [s, rad, m]: a latency, a pitch and a height that change the depth about as
much."""
PITCHES, HEIGHTS, LATENCIES = (
    np.linspace(-4.0, 4.0, 17),
    (-2.0, -1.0, 0.0, 1.0, 2.0),
    (-1.0, 1.0, 2.0, 3.0, 4.0, 5.0),
)
"""First points, in that unit: the bounds of what the problem searches."""
EVALUATIONS = 250


def depth_misfit(predicted: Floats, measured: Floats, range_m: float) -> float:
    """Mean relative error, at most `GROSS`.

    A pixel that is invalid should be out of range, but may be a hole.
    """
    valid = measured > 0.0
    error = np.minimum(np.abs(predicted - measured) / np.where(valid, measured, 1.0), GROSS)
    return float(np.mean(np.where(valid, error, 0.1 * GROSS * (predicted < WHOLE * range_m))))


def align_camera(model: DepthModel, kept: Indices, measured: Floats) -> CameraEffects:
    """Latency, pitch and height at which the scene agrees with the images.

    As claimed where it is not far off there.

    Edges need not lie where they are claimed: all pixels count, and none for more than another
    surface does.
    """
    some = np.arange(len(kept))[:: max(1, len(kept) // FRAMES)]

    def cost(point: Floats | tuple[float, ...]) -> float:
        predicted = model.predict(_effects(point), kept[some])
        return depth_misfit(predicted, measured[some], model.camera.range_m)

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
