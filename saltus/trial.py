"""A trial: everything that a seed draws, and the judgement whether the robot made it.

What is drawn, here and in training, is drawn around what a robot's profile says, never in its
place. Ranges are stated for the nominal robot. Where a profile says another delay, the range moves
by the difference, and a profile without that delay keeps none; factors multiply; masses, shifts and
jitter add up.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.config import TomlValue
from saltus.effects.camera import drawn_around
from saltus.effects.effect import Effect
from saltus.effects.heightmap_shift import refuse_shift, shift_of
from saltus.effects.motors import TorqueGain
from saltus.effects.profile import Profile
from saltus.rotations import roll_pitch_yaw, rotation_matrix
from saltus.terrain.terrain import Terrain
from saltus.wire.topics import CAMERA_JITTER_S, CAMERA_LATENCY_S

Effects: TypeAlias = tuple[Effect, ...]
FailureCause = Literal["", "trunk_contact", "not_upright", "time_limit", "ended"]

UPRIGHT_LIMIT = np.deg2rad(60.0)  # definition of success: |roll| and |pitch| below it
TIME_LIMIT_S = 20.0  # definition of success
NOMINAL_FEEDFORWARD_DELAY_S = 0.010  # original
_SHIFT = 1  # names the random numbers of what a profile lets every robot draw of the shift


@dataclass(frozen=True, kw_only=True)
class Trial(TomlValue):
    """Values that differ from trial to trial.

    The defaults are the nominal trial, without randomness.
    """

    seed: int = 0
    """Seed of everything random that is not drawn here: jitter, noise."""
    position_x: float = 0.0
    """Place of the base at the start [m]."""
    yaw: float = 0.0
    """Yaw of the base at the start [rad]."""
    friction: float = 0.8
    """Between feet and ground."""
    payload_kg: float = 0.0
    motor_strength: float = 1.0
    """Delivered over expected torque."""
    camera_delay_s: float = CAMERA_LATENCY_S
    """Exposure to arrival."""
    camera_jitter_s: float = 0.0
    """Half-width of its variation from frame to frame."""
    height_shift_x: float = 0.0
    """True heights are handed out for a place this far ahead [m]."""
    height_shift_z: float = 0.0
    """True heights are handed out this much too high [m]."""

    @classmethod
    def draw(cls, seed: int) -> "Trial":
        """The trial that belongs to `seed`; ranges from the project's definition of a trial."""
        rng = np.random.default_rng(np.random.SeedSequence(seed))
        return cls(
            seed=seed,
            position_x=float(rng.uniform(-0.2, 0.2)),
            yaw=float(rng.uniform(-0.05, 0.05)),
            friction=float(rng.uniform(0.5, 1.0)),
            payload_kg=float(rng.uniform(0.0, 1.5)),
            motor_strength=float(rng.uniform(0.9, 1.1)),
            camera_delay_s=float(rng.uniform(0.030, 0.060)),
            camera_jitter_s=CAMERA_JITTER_S,
            height_shift_x=float(rng.uniform(-0.08, 0.08)),
            height_shift_z=float(rng.uniform(-0.05, 0.05)),
        )

    def applied_to(self, profile: Profile) -> Profile:
        """The effects of this trial's robot: those of `profile`, moved by what the trial draws.

        See this module.

        Raises:
            ConfigError: a profile that shifts true heights: robots that see with a camera have
                none.
        """
        refuse_shift(profile.heightmap, "a robot that sees with a camera")
        camera = drawn_around(
            profile.camera, latency_s=self.camera_delay_s, jitter_s=self.camera_jitter_s
        )
        drives = strengthen_drives(profile.actuator, self.motor_strength)
        return replace(profile, actuator=drives, camera=camera)

    def height_shift(self, profile: Profile) -> Floats:
        """How far ahead, and how much too high,
        this robot is handed out true heights [m], shape (2,).
        """
        shift = shift_of(profile.heightmap).moved(x=self.height_shift_x, z=self.height_shift_z)
        return shift.init((), np.random.default_rng((self.seed, _SHIFT)))


def strengthen_drives(drives: Effects, strength: float | Floats) -> Effects:
    """Effects of drives whose torque gain is multiplied.

    Strengths of robots that differ have the shape (n, 1).
    """
    known = [effect.gain for effect in drives if isinstance(effect, TorqueGain)] or [1.0]
    gain = np.asarray(known[0]) * strength
    value = gain if gain.ndim == 2 else float(gain) if gain.ndim == 0 else tuple(gain.tolist())
    return (
        *(effect for effect in drives if not isinstance(effect, TorqueGain)),
        TorqueGain(gain=value),
    )


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How a trial went."""

    success: bool
    cause: FailureCause
    """Why not; empty for a success."""
    time_s: float
    """From passing `Terrain.timing_x` to the finish, or to the end of the trial; 0 if it was never
    passed."""
    distance_m: float
    """How far the trunk came along x from its start."""
    mean_speed_mps: float
    """Horizontal speed while the time ran; 0 if it never did."""


def is_upright(quaternion: Floats) -> NDArray[np.bool_]:
    """True where roll and pitch are both within 60 degrees.

    Shape (..., 4), (w, x, y, z) -> (...).
    """
    rotation = rotation_matrix(quaternion)
    roll, pitch, _ = roll_pitch_yaw(rotation)
    return (abs(roll) < UPRIGHT_LIMIT) & (abs(pitch) < UPRIGHT_LIMIT)


class TrialMonitor:
    """Watches one trial, sample by sample, and says when it is over and how it went."""

    def __init__(self, terrain: Terrain, time_limit_s: float = TIME_LIMIT_S) -> None:
        self._terrain = terrain
        self._limit_s = time_limit_s
        self._first: tuple[float, float] | None = None
        self._last: tuple[float, float] = (0.0, terrain.start_x)
        self._timing: tuple[float, float] | None = None
        self.outcome: Outcome | None = None
        """None while the trial goes on."""

    def step(
        self, time_s: float, position: Floats, quaternion: Floats, trunk_contact: bool
    ) -> Outcome | None:
        """Takes in one sample; ignores all that come after the end.

        Args:
            time_s: Since the start of the trial [s], rising.
            position: Trunk centre, world frame [m], shape (3,).
            quaternion: (w, x, y, z), shape (4,).
            trunk_contact: Whether the trunk touched anything since the last sample.
        """
        if self.outcome is not None:
            return self.outcome
        sample = (time_s, float(position[0]))
        if self._first is None:
            self._first = self._last = sample
        if self._timing is None and sample[1] >= self._terrain.timing_x:
            self._timing = _crossing(self._last, sample, self._terrain.timing_x)
        before, self._last = self._last, sample
        if trunk_contact:
            return self.end("trunk_contact")
        if not is_upright(np.asarray(quaternion, dtype=np.float64)):
            return self.end("not_upright")
        if sample[1] >= self._terrain.finish_x:
            self._last = _crossing(before, sample, self._terrain.finish_x)
        if self._last[0] - self._first[0] > self._limit_s:
            return self.end("time_limit")
        return self.end("") if sample[1] >= self._terrain.finish_x else None

    def end(self, cause: FailureCause = "ended") -> Outcome:
        """Ends the trial now; "ended" where something else than the robot ended it."""
        if self.outcome is None:
            start_x = self._first[1] if self._first else self._last[1]
            timed = self._timing or self._last
            time_s, way = self._last[0] - timed[0], self._last[1] - timed[1]
            self.outcome = Outcome(
                success=cause == "",
                cause=cause,
                time_s=time_s,
                distance_m=self._last[1] - start_x,
                mean_speed_mps=way / time_s if time_s > 0.0 else 0.0,
            )
        return self.outcome


def judge(
    terrain: Terrain,
    time_s: Floats,
    position: Floats,
    quaternion: Floats,
    trunk_contact: Sequence[bool] | NDArray[np.bool_],
    time_limit_s: float = TIME_LIMIT_S,
) -> Outcome:
    """The outcome of a recorded trial.

    Arrays as for `TrialMonitor.step`, with a leading dimension of samples.
    """
    monitor = TrialMonitor(terrain, time_limit_s)
    for sample in zip(time_s, position, quaternion, trunk_contact, strict=True):
        if monitor.step(float(sample[0]), sample[1], sample[2], bool(sample[3])) is not None:
            break
    return monitor.end()


def _crossing(
    before: tuple[float, float], after: tuple[float, float], x: float
) -> tuple[float, float]:
    """Time and place at which a straight line between two samples (time, x) passes `x`;
    `after` if it began there.
    """
    if before[1] >= x or after[1] == before[1]:
        return after
    share = (x - before[1]) / (after[1] - before[1])
    return before[0] + share * (after[0] - before[0]), x
