"""Depth that a camera with given effects measures at some pixels of all images of a log."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Indices
from saltus.real2sim.problem.camera.candidates import CameraEffects
from saltus.real2sim.problem.camera.pose import BaseMotion, ClaimedCamera
from saltus.real2sim.problem.camera.rays import VisibleScene
from saltus.robots.mount import Mount
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
    """Images in the order in which a temporal filter has seen them; repeats may be among them. Shape (filtered,)."""
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
            share[k] = mixed if self.is_hole is None else np.where(self.is_hole[k] | self.is_hole[k - 1], 1.0, mixed)
        return np.asarray(share[np.searchsorted(self.shown, kept)])

    def rays(self, effects: CameraEffects, kept: Indices) -> tuple[Floats, Floats]:
        """Origins [m], shape (kept, 3), and directions, shape (kept, 3, pixels), in the world frame."""
        exposed_s = self.stamp_s[kept] - effects.arrival_jitter * self.jitter_s[kept]
        exposed_s = exposed_s - self.camera.latency_s - effects.camera_latency
        position, rotation = self.motion.at(exposed_s)
        position, rotation = position + self.shift_m, rotation @ (np.eye(3) + skew(self.turn_rad))
        raised = self.camera.position + np.array([0.0, 0.0, effects.camera_height])
        mount = Mount(
            position=raised, pitch=self.camera.pitch + effects.camera_pitch, roll=self.camera.roll, yaw=self.camera.yaw
        )
        wider = 1.0 + effects.camera_fov
        looks = mount.rotation @ (self.tangents * np.array([[wider], [wider], [1.0]]))
        return position + rotation @ mount.position, rotation @ looks

    def _image(self, effects: CameraEffects, kept: Indices) -> Floats:
        depth = self.scene.depth(*self.rays(effects, kept))
        depth = np.minimum((1.0 + effects.depth_scale) * depth + effects.depth_bias, self.camera.range_m)
        if effects.range_clip > 0.0:
            depth = depth - effects.range_clip * np.maximum(depth - effects.clip_m, 0.0)
        return depth
