"""How noisy the signals of a standing robot are, and residuals in units of that noise.

Two things part a true simulation from a measurement: noise of the sensors, and the error of the
state from which a window starts, which comes from the same sensors and fades as the window goes on.
The second is a random vector of few dimensions; its effect on all later samples is found by
simulating each dimension once, and is then taken out to the degree to which it is likely.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Indices
from saltus.constants import PHYSICS_DT
from saltus.real2sim.problem import quaternions, stream_noise
from saltus.real2sim.problem.body.windows import BLOCK_STEPS, SMOOTHING_STEPS
from saltus.real2sim.problem.stream_noise import rotation_columns
from saltus.recordings.run_log import RunLog
from saltus.robots.robot import JOINTS
from saltus.rotations import rotation_matrix

KINDS = ("position", "tilt", "velocity", "q", "dq")
"""Kinds of signals, each with one noise: the axes of a sensor are alike."""
SIGNALS = (
    *(
        "base_x",
        "base_y",
        "base_z",
        "base_roll",
        "base_pitch",
        "base_yaw",
        "base_vx",
        "base_vy",
        "base_vz",
    ),
    *(f"{signal}_{joint}" for signal in ("q", "dq") for joint in JOINTS),
)
"""Along the heading and in the base frame, see `signal_errors`."""
KIND_OF_SIGNAL = np.array([0] * 3 + [1] * 3 + [2] * 3 + [3] * 12 + [4] * 12)
"""Shape (33,): base position, tilt and heading, velocity, joints, joint velocities."""
SMALLEST = np.array([2e-5, 2e-5, 2e-4, 1e-5, 5e-4])
"""Least noise of a mean over 20 ms that is believed [m, rad, m/s, rad, rad/s]: what the simulation
itself repeats."""
LARGEST_UNREPEATED = 10.0
"""Segments with a window in which right simulations differ by this many times the power of the
noise are left out: what a foot does there hangs on a hair."""
LARGEST_LASTING = 1.0
"""Windows are left out in which errors of the start have not faded below the noise: a foot is about
to lift or slip there, and the simulation goes its own way."""
UNKNOWN_PLACE_M, UNKNOWN_HEADING_RAD = 0.05, 0.1
"""Where on flat ground a robot stands, and which way it faces, tells nothing: they start free."""


@dataclass(frozen=True, kw_only=True)
class BodyNoise:
    """Noise of the body's signals, as means over blocks, by kind of signal: shapes (5,)."""

    sigma: Floats
    correlation: Floats
    """From block to block."""

    def plain(self, error: Floats, sigma: Floats | None = None) -> Floats:
        """Errors of unit variance without correlation from block to block,
        were windows to start from true states.

        Args:
            error: Shape (..., blocks, 33).
            sigma: Standard deviations other than these, same shape or less.
        """
        phi = self.correlation[KIND_OF_SIGNAL]
        scaled = error / (self.sigma[KIND_OF_SIGNAL] if sigma is None else sigma)
        later = (scaled[..., 1:, :] - phi * scaled[..., :-1, :]) / np.sqrt(1.0 - phi**2)
        return np.concatenate([scaled[..., :1, :], later], axis=-2)


def signal_errors(measured: Floats, simulated: Floats) -> Floats:
    """Measured minus simulated in 33 signals.

    Args:
        measured: Columns as `body_windows.POSE` and following, shape (..., 34).
        simulated: The same, shape (..., 34).

    Returns:
        Position of the base along the measured heading, rotation vector in the base frame, velocity
        along the heading, joints, joint velocities; shape (..., 33).
    """
    quaternion = quaternions.normalise_quaternions(measured[..., 3:7])
    rotation = rotation_matrix(quaternion)
    along = rotation[..., :2, 0] / np.linalg.norm(rotation[..., :2, 0], axis=-1, keepdims=True)
    c, s = along[..., 0], along[..., 1]
    moved = measured - simulated

    def turned(vector: Floats) -> list[Floats]:
        return [
            c * vector[..., 0] + s * vector[..., 1],
            c * vector[..., 1] - s * vector[..., 0],
            vector[..., 2],
        ]

    model = quaternions.normalise_quaternions(simulated[..., 3:7])
    w, v = model[..., :1], model[..., 1:]
    tilt = 2.0 * (
        w * quaternion[..., 1:] - quaternion[..., :1] * v - np.cross(v, quaternion[..., 1:])
    )
    tilt = tilt * np.sign(np.sum(model * quaternion, axis=-1, keepdims=True))
    parts = [
        np.stack(turned(moved[..., :3]), axis=-1),
        tilt,
        np.stack(turned(moved[..., 19:22]), axis=-1),
    ]
    return np.concatenate([*parts, moved[..., 7:19], moved[..., 22:]], axis=-1)


def read_body_noise(log: RunLog) -> BodyNoise:
    """Noise of the signals of a log with a measured base, from what is too quick for a body."""
    joints, base = log.joints, log.base
    if base is None:
        raise ValueError("the log has no base.csv")
    streams = [
        (base.time_s, base.values[:, :3]),
        (base.time_s, rotation_columns(base.values[:, 3:7])),
        (base.time_s, base.values[:, 7:10]),
        (joints.time_s, joints.q),
        (joints.time_s, joints.q if joints.dq is None else joints.dq),
    ]
    found = np.array(
        [
            stream_noise.read_stream_noise(*stream).of_means(BLOCK_STEPS * PHYSICS_DT)
            for stream in streams
        ]
    )
    return BodyNoise(sigma=np.maximum(found[:, 0], SMALLEST), correlation=found[:, 1])


class BodyWhitening:
    """Turns errors of the body's signals into residuals of unit variance.

    Args:
        noise: Of the sensors.
        starts: Error of each window under the starting error of each dimension, one standard
            deviation large, shape (dimensions, w, blocks, 33).
        measured: What is added to errors, were windows to start as measured rather than where they
            are likeliest, shape (w, blocks, 33).
        unrepeated: Variance of what a right simulation does not repeat either, shape (w, blocks,
            33).
        lasting: Power of errors of the start late in each window, in units of the noise, shape
            (w,).
        segment: Of each window, shape (w,).
    """

    def __init__(
        self,
        noise: BodyNoise,
        starts: Floats,
        measured: Floats,
        unrepeated: Floats,
        lasting: Floats,
        segment: Indices,
    ) -> None:
        sensors = noise.sigma[KIND_OF_SIGNAL] ** 2
        self._sigma = np.sqrt(sensors + unrepeated)
        unrepeated_power = np.mean(unrepeated / sensors, axis=(1, 2))
        worst = np.array([unrepeated_power[segment == s].max() for s in segment])
        is_steady = lasting <= max(LARGEST_LASTING, float(lasting.min()))
        self.is_reproducible = is_steady & (
            worst <= max(LARGEST_UNREPEATED, float(worst[is_steady].min()))
        )
        self._noise, self._measured = noise, measured
        plain = noise.plain(starts, self._sigma)  # (d, w, blocks, 33)
        flat = plain.reshape(*plain.shape[:2], -1).transpose(1, 2, 0)
        self._basis, size, _ = np.linalg.svd(flat, full_matrices=False)  # (w, blocks * 33, d)
        self._shrink = 1.0 - 1.0 / np.sqrt(1.0 + size**2)

    def __call__(self, error: Floats) -> Floats:
        """Residuals of errors, both of shape (n, w, blocks, 33);
        0 in windows that no simulation can reproduce.
        """
        plain = self._noise.plain(error + self._measured, self._sigma)
        flat = plain.reshape(*plain.shape[:2], -1).transpose(1, 2, 0)  # (w, blocks * 33, n)
        flat = flat - self._basis @ (self._shrink[..., None] * (self._basis.mT @ flat))
        whitened = flat.transpose(2, 0, 1).reshape(plain.shape)
        return np.asarray(whitened * self.is_reproducible[:, None, None])


@dataclass(frozen=True, kw_only=True)
class StartNoise:
    """Standard deviations of the state at the start of a window."""

    sigma: Floats
    """Base position (3), tilt (3), velocity (3), rates (3), joints (12), joint velocities (12);
    shape (36,)."""

    @property
    def is_free(self) -> NDArray[np.bool_]:
        """Dimensions that start anywhere: place and heading."""
        return np.isin(np.arange(self.sigma.size), (0, 1, 5))

    @classmethod
    def of(cls, noise: BodyNoise, *, has_gyro: bool) -> "StartNoise":
        """Noise of smoothed states; `noise` is that of means over blocks."""
        # a parabola through n samples has 9 / (4 n) of their variance in its middle
        position, tilt, velocity, q, dq = (
            np.sqrt(2.25 * BLOCK_STEPS / SMOOTHING_STEPS) * noise.sigma
        )
        # and its slope 12 / n^3
        rate = np.sqrt(12.0 * BLOCK_STEPS / SMOOTHING_STEPS**3) / PHYSICS_DT * noise.sigma[1]
        place, heading = UNKNOWN_PLACE_M, UNKNOWN_HEADING_RAD
        parts = [
            place,
            place,
            position,
            tilt,
            tilt,
            heading,
            *[velocity] * 3,
            *[rate * (0.5 if has_gyro else 1.0)] * 3,
        ]
        return cls(sigma=np.array([*parts, *[q] * 12, *[dq] * 12]))

    def moved(self, qpos: Floats, qvel: Floats, by: Floats) -> tuple[Floats, Floats]:
        """States that are off `by` so many standard deviations.

        Args:
            qpos: Shape (w, 19).
            qvel: Shape (w, 18).
            by: Shape (k, w or 1, 36).

        Returns:
            Shapes (k, w, 19) and (k, w, 18).
        """
        change = np.broadcast_to(by * self.sigma, (len(by), len(qpos), 36))
        quaternion = quaternions.turn_slightly(
            np.broadcast_to(qpos[:, 3:7], (*change.shape[:2], 4)), change[..., 3:6]
        )
        joints = qpos[:, 7:] + change[..., 12:24]
        places = np.concatenate([qpos[:, :3] + change[..., :3], quaternion, joints], axis=-1)
        order = np.r_[6:9, 9:12, 24:36]
        return places, qvel + change[..., order]


LARGEST_NORM = 1.5
"""A start that were off by more times as much as starts are in the mean is no error of a start but
a gap: there windows start as measured."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WindowStarts:
    """Errors of the starts of w windows, in standard deviations of d dimensions.

    Attributes:
        likeliest: Shape (w, d).
        root: Of the covariance of what is unknown of them still, shape (w, d, d).
    """

    likeliest: Floats
    root: Floats

    @classmethod
    def of(
        cls, noise: BodyNoise, claimed: Floats, slopes: Floats, effects: Floats
    ) -> "WindowStarts":
        """The starts that windows tell of, whatever effects the robot has:
        they are fitted with them, to first order.

        Args:
            noise: Of the sensors.
            claimed: Errors of windows that start as measured, shape (w, blocks, 33).
            slopes: What errors change by with each dimension, shape (d, w, blocks, 33).
            effects: What they change by with an effect of usual size, shape (e, w, blocks, 33).
        """
        error = noise.plain(claimed).reshape(len(claimed), 1, -1)
        slope, effect = (
            noise.plain(s).reshape(*s.shape[:2], -1).transpose(1, 0, 2) for s in (slopes, effects)
        )
        information = slope @ slope.mT + np.eye(len(slopes))
        # (w, e, m): what no start imitates
        rest = effect - (effect @ slope.mT) @ np.linalg.solve(information, slope)
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
