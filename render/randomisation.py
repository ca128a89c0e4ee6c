"""What differs from one camera to the next: distributions to train on, in one config."""

import math
from dataclasses import dataclass, replace

import numpy as np

from saltus.depth import Intrinsics
from saltus.effects.camera import CameraChain
from saltus.effects.camera_latency import CameraLatency
from saltus.effects.frame_drop import FrameDrop
from saltus.errors import ConfigError
from saltus.render.camera import Mount
from saltus.render.stereo.camera import StereoConfig
from saltus.render.stereo.sensor_freeze import SensorFreeze
from saltus.rotations import rotation_matrix
from saltus.wire.messages import Floats


@dataclass(frozen=True, kw_only=True)
class Uniform:
    """A uniform distribution; one value where both ends are equal."""

    low: float
    high: float

    def __post_init__(self) -> None:
        if not -math.inf < self.low <= self.high < math.inf:
            raise ConfigError(f"distribution from low = {self.low!r} to high = {self.high!r}: give numbers that rise")

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Shape (count,)."""
        return rng.uniform(self.low, self.high, count)


@dataclass(frozen=True, kw_only=True)
class CameraRandomisation:
    """Distributions of all that differs from camera to camera."""

    # +-1 cm: a printed mount, and what published training of legged robots with depth cameras uses
    position_x_m: Uniform = Uniform(low=-0.01, high=0.01)
    """Of the optical centre, base frame, added to the mount."""
    position_y_m: Uniform = Uniform(low=-0.01, high=0.01)
    position_z_m: Uniform = Uniform(low=-0.01, high=0.01)
    # extrinsic pitch is 0.5 to 3 degrees off on real robots
    pitch_rad: Uniform = Uniform(low=-math.radians(2.0), high=math.radians(2.0))
    """Nose down positive, added to the mount."""
    roll_rad: Uniform = Uniform(low=-math.radians(1.0), high=math.radians(1.0))
    """About the optical axis."""
    # focal lengths are 1 to 3 % off on real robots, crop and resize included
    focal_scale: Uniform = Uniform(low=0.98, high=1.02)
    # half a pixel of the sensor is a tenth of a model pixel; the original's own crop is off by one row and column
    principal_px: Uniform = Uniform(low=-1.0, high=1.0)
    """Of the principal point, in pixels of the sensor, drawn for x and y."""
    # original: 30 to 60 ms
    latency_s: Uniform = Uniform(low=0.030, high=0.060)
    # 1 to 10 ms
    jitter_s: Uniform = Uniform(low=0.0, high=0.010)
    # 0.5 to 20 % under load
    drop_fraction: Uniform = Uniform(low=0.0, high=0.1)
    # a hundredth of frames begins a freeze of 90 frames in published training; here a tenth of that
    freeze_rate_hz: Uniform = Uniform(low=0.0, high=0.05)
    freeze_s: Uniform = Uniform(low=0.1, high=1.0)
    # sub-pixel noise 0.03 px at best, 0.08 px in practice, and worse on poor texture
    noise_strength: Uniform = Uniform(low=0.4, high=2.0)
    """Factor on noise, holes and flying pixels."""

    def draw(self, count: int, rng: np.random.Generator) -> "CameraDraw":
        """Draws `count` cameras."""

        def of(distribution: Uniform) -> Floats:
            return distribution.draw(count, rng)

        return CameraDraw(
            position=np.stack([of(self.position_x_m), of(self.position_y_m), of(self.position_z_m)], axis=-1),
            pitch=of(self.pitch_rad),
            roll=of(self.roll_rad),
            focal_scale=of(self.focal_scale),
            principal_px=np.stack([of(self.principal_px), of(self.principal_px)], axis=-1),
            latency_s=of(self.latency_s),
            jitter_s=of(self.jitter_s),
            drop_fraction=of(self.drop_fraction),
            freeze_rate_hz=of(self.freeze_rate_hz),
            freeze_s=of(self.freeze_s),
            noise_strength=of(self.noise_strength),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraDraw:
    """A batch of cameras that differ; arrays of shape (count,) or (count, n)."""

    position: Floats
    """Added to the optical centre [m], base frame, shape (count, 3)."""
    pitch: Floats
    """[rad], nose down positive."""
    roll: Floats
    """[rad], about the optical axis."""
    focal_scale: Floats
    principal_px: Floats
    """[px of the sensor], shape (count, 2)."""
    latency_s: Floats
    jitter_s: Floats
    drop_fraction: Floats
    freeze_rate_hz: Floats
    freeze_s: Floats
    noise_strength: Floats

    def moved(self, mount: Mount, base_position: Floats, base_quaternion: Floats) -> tuple[Floats, Floats]:
        """Poses of bases at which a camera on `mount` sees what the drawn cameras see on the true bases.

        With these a renderer of one mount renders all cameras. The legs move along with the base; they err by what the
        extrinsics differ, which is small against how they move.

        Args:
            mount: of the renderer.
            base_position: true ones [m], world frame, shape (count, 3).
            base_quaternion: (w, x, y, z), base to world, shape (count, 4).

        Returns:
            Positions and quaternions, shapes as given.
        """
        zero = np.zeros_like(self.pitch)
        nod = np.stack([np.cos(self.pitch / 2), zero, np.sin(self.pitch / 2), zero], axis=-1)
        axis = mount.rotation[:, 2]
        tilt = np.concatenate([np.cos(self.roll / 2)[:, None], np.sin(self.roll / 2)[:, None] * axis], axis=-1)
        turned = _product(base_quaternion, _product(nod, tilt))
        true_centre = _rotated(base_quaternion, mount.position + self.position)
        return base_position + true_centre - _rotated(
            turned, np.broadcast_to(mount.position, true_centre.shape)
        ), turned

    def intrinsics(self, camera: Intrinsics, index: int, pitch_px: float = 1.0) -> Intrinsics:
        """The intrinsics of one of the cameras; renderers have one set each, so give each group of robots a draw.

        Args:
            camera: nominal.
            index: of the camera.
            pitch_px: pixels of the sensor for each of `camera`.
        """
        x, y = self.principal_px[index] / pitch_px
        scale = float(self.focal_scale[index])
        return replace(
            camera, fx=camera.fx * scale, fy=camera.fy * scale, cx=camera.cx + float(x), cy=camera.cy + float(y)
        )

    def stereo(self, config: StereoConfig) -> StereoConfig:
        """The stereo effects of each camera, by its noise strength."""
        strength = self.noise_strength

        def share(value: object) -> Floats:
            return np.minimum(np.asarray(value) * strength, 1.0)

        return replace(
            config,
            disparity_noise=replace(config.disparity_noise, sigma=np.asarray(config.disparity_noise.sigma) * strength),
            edge_holes=replace(config.edge_holes, fraction=share(config.edge_holes.fraction)),
            weak_signal=replace(config.weak_signal, reach=np.asarray(config.weak_signal.reach) / np.sqrt(strength)),
            flying_pixels=replace(config.flying_pixels, fraction=share(config.flying_pixels.fraction)),
        )

    @property
    def freeze(self) -> SensorFreeze:
        """What the sensors do before their images are sent."""
        return SensorFreeze(rate=self.freeze_rate_hz, duration=self.freeze_s)

    @property
    def link(self) -> CameraChain:
        """What happens to the images on their way: drops, latency, jitter."""
        return CameraChain(
            (FrameDrop(fraction=self.drop_fraction), CameraLatency(latency=self.latency_s, jitter=self.jitter_s))
        )


def _rotated(quaternion: Floats, vector: Floats) -> Floats:
    """Base to world, shapes (count, 4), (count, 3) -> (count, 3)."""
    return (rotation_matrix(np.asarray(quaternion, dtype=np.float64)) @ vector[..., None])[..., 0]


def _product(a: Floats, b: Floats) -> Floats:
    """Hamilton product of quaternions (w, x, y, z), shape (..., 4)."""
    scalar = a[..., :1] * b[..., :1] - np.sum(a[..., 1:] * b[..., 1:], axis=-1, keepdims=True)
    vector = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + np.cross(a[..., 1:], b[..., 1:])
    return np.concatenate([scalar, vector], axis=-1)
