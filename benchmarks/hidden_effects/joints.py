"""Runs of joints with the base held: the rig, its motion and its noise."""

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.hidden_effects import joint_effects, motions
from benchmarks.hidden_effects.joint_effects import FAMILIES, LIBRARY, OUTSIDE, Peak
from benchmarks.hidden_effects.legs import Hidden, Rig, mean_delay, simulate
from benchmarks.hidden_effects.noise import coloured
from benchmarks.hidden_effects.robot import JOINTS, KINDS, LEGS, STAND, TORQUE_LIMIT, Floats
from benchmarks.hidden_effects.scene import Scene, Setting

FASTEST_TICK, SLOWEST_TICK = 1, 16
"""Steps of 0.125 ms between two evaluations of the PD law: 8 kHz, and the 500 Hz that every drive
has at least."""
CLOCK_S = 1e-3
"""By which a drive's clock may be off: half of a period at 500 Hz, the mean age of a torque that is
held."""
ASKED = 1.1
"""Largest torque that may be asked for in an experiment, in parts of a joint's limit."""
SHOWN = 2
"""Signals that count in a response: position and velocity. Believed torque follows from them and
the command; a packet that is late by nothing at all would move its sample at a jump by the whole
jump."""


@dataclass(frozen=True, kw_only=True)
class Noise:
    """Noise that the sensors add."""

    sigma: Floats
    """Sigma of position, velocity and believed torque [rad, rad/s, Nm], shape (3,)."""
    corner_hz: float
    slow_hz: float
    slow_share: float
    """Share of the variance of noise that is slow."""


class JointScene(Scene):
    """Four legs in the air.

    Args:
        quiet: Slow and small motions only, which show few effects.
        legs: Legs that are simulated for responses; the log always has all four.
    """

    families = FAMILIES
    library = tuple(LIBRARY)
    outside = tuple(OUTSIDE)

    def __init__(
        self, seed: int, *, tuning: bool, quiet: bool, legs: tuple[int, ...] = (0, 1, 2, 3)
    ) -> None:
        rng = np.random.default_rng(seed)
        self.tuning, self.legs, self.seed = tuning, legs, seed
        control_dt = 0.005 if rng.uniform() < 0.2 else 0.002
        command, self.segments = motions.commands(
            rng, control_dt=control_dt, length_s=rng.uniform(22, 38), tuning=tuning, quiet=quiet
        )
        kp = rng.uniform(20, 50)
        kd = np.sqrt(kp) * rng.uniform(0.12, 0.22)
        gains = np.tile([1.0, 1.0, rng.choice([1.0, 0.8])], 4)
        tick = int(rng.choice([1, 4, 8] if control_dt == 0.005 else [1, 4, 8, 16]))
        self.rig = Rig(
            command=command,
            kp=(kp * gains).round(2),
            kd=(kd * gains).round(3),
            control_dt=control_dt,
            tick_steps=tick,
        )
        self.noise = Noise(
            sigma=np.array([1.0e-3, 0.05, 0.2]) * np.exp(rng.uniform(-0.4, 0.4, 3)),
            corner_hz=rng.uniform(20, 200),
            slow_hz=rng.uniform(1, 6),
            slow_share=rng.uniform(0, 0.3),
        )
        ideal = simulate(self.rig, [Hidden()])[0]
        self.peak = Peak(
            speed=np.abs(ideal[..., 1]).max(axis=0), torque=np.abs(ideal[..., 2]).max(axis=0)
        )
        self._index()

    def perform(
        self, command: Floats, segments: tuple[motions.Segment, ...], stiffer: float
    ) -> None:
        """Has the same robot do something else, with other gains,
        within what its drives can give.
        """
        kp, kd = (stiffer * self.rig.kp).round(2), (np.sqrt(stiffer) * self.rig.kd).round(3)
        rig = replace(self.rig, command=command, kp=kp, kd=kd)
        torque = np.abs(simulate(rig, [Hidden()])[0][..., 2]).max(axis=0)
        part = min(1.0, float((ASKED * TORQUE_LIMIT / torque).min()))
        rest = np.stack([STAND, np.zeros(12), np.zeros(12)], axis=-1)
        self.rig, self.segments = replace(rig, command=rest + part * (command - rest)), segments

    def largest(self, setting: Setting) -> float:
        return joint_effects.largest(setting, self.peak)

    def respond(self, variants: list[tuple[Setting, ...]]) -> Floats:
        """Every second row of the legs that are simulated."""
        hidden = [joint_effects.hidden(settings, self.peak) for settings in variants]
        return self._shown(simulate(self.rig, hidden, self.legs, self.seed))

    def parameters(self, setting: Setting) -> dict[str, float | list[list[float]]]:
        """Delays as the packets had them, from their sending to their first use."""
        result = joint_effects.parameters(setting, self.peak)
        if setting.effect in ("command_delay", "feedforward_delay"):
            joint = JOINTS.index(setting.where[0])
            late = mean_delay(self.rig, self._as_logged((setting,)), self.seed)
            result["delay"] = float(late[setting.effect == "feedforward_delay"][joint])
        return result

    def parameters_at(self, setting: Setting) -> dict[str, dict[str, float | list[list[float]]]]:
        return joint_effects.parameters_at(setting, self.peak)

    def measure(self, settings: tuple[Setting, ...], rng: np.random.Generator) -> Floats:
        """Returns what is logged: position, velocity, believed torque with noise.

        Shape (rows, 12, 3).
        """
        clean = simulate(self.rig, [self._as_logged(settings)], seed=self.seed)[0]
        rate = 1.0 / self.rig.control_dt
        slow = {"slow_share": self.noise.slow_share, "slow_hz": self.noise.slow_hz}
        noise = coloured(rng, clean.shape, self.noise.corner_hz, rate, self.tuning, **slow)
        return np.asarray(clean + self.noise.sigma * noise)

    def _as_logged(self, settings: tuple[Setting, ...]) -> Hidden:
        return joint_effects.hidden(settings, self.peak, self.rig.control_dt)

    def _unclaimed(self) -> Floats:
        """From the slowest drive to the fastest, and a clock that is off:
        of position and velocity alike, (2, m).
        """
        rigs = [replace(self.rig, tick_steps=steps) for steps in (FASTEST_TICK, SLOWEST_TICK)]
        fast, slow, own = (
            self._shown(simulate(rig, [Hidden()], self.legs, self.seed))[0]
            for rig in (*rigs, self.rig)
        )
        # All commands late: what moves, moves later
        late = Hidden(command_delay=np.full(12, CLOCK_S))
        clock = self._shown(simulate(self.rig, [late], self.legs, self.seed))[0] - own
        return np.stack([slow - fast, clock])

    def _shown(self, clean: Floats) -> Floats:
        columns = [3 * leg + kind for leg in self.legs for kind in range(3)]
        return np.asarray(
            (clean[:, ::2, columns, :SHOWN] / self.noise.sigma[:SHOWN]).reshape(len(clean), -1)
        )

    def _index(self) -> None:
        rows = np.arange(0, len(self.rig.command), 2)
        starts = np.array([segment.start_s for segment in self.segments])
        segment = np.searchsorted(starts, rows * self.rig.control_dt + 1e-9, side="right") - 1
        joints = [3 * leg + kind for leg in self.legs for kind in range(3)]
        shape = (len(rows), len(joints), SHOWN)
        group = segment[:, None, None] * SHOWN + np.arange(SHOWN)
        self.group = np.broadcast_to(group, shape).ravel()
        self.places = np.broadcast_to(np.array(JOINTS)[joints][:, None], shape).ravel()
        self.nuisances = self._unclaimed()


def draw_where(rng: np.random.Generator) -> tuple[str, ...]:
    """All joints, one kind of joint, one leg or one joint."""
    choice = rng.integers(4)
    if choice == 0:
        return JOINTS
    if choice == 1:
        kind = rng.choice(KINDS)
        return tuple(joint for joint in JOINTS if joint.endswith(kind))
    if choice == 2:
        leg = rng.choice(LEGS)
        return tuple(joint for joint in JOINTS if joint.startswith(leg))
    return (str(rng.choice(JOINTS)),)
