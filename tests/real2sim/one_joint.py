"""Pendulums under PD control, simulated in numpy:
a small problem with the effects that robots' joints have.
"""

from dataclasses import dataclass, replace

import numpy as np

from saltus.arrays import Floats
from saltus.real2sim.problem.joints.candidates import KINDS
from saltus.real2sim.problem.problem import Candidate, LogSegment, Problem, Unknown

KP, KD, INERTIA, GRAVITY = 20.0, 0.5, 0.02, 1.5  # a joint of a Go1's class
STEP_S, ROWS_EVERY, WINDOW_S = 0.004, 4, 1.0
NOISE_Q, NOISE_DQ = 0.001, 0.05
STALL = 40.0  # Nm, of the pendulum that has a torque-speed limit
WHERES = ("hip", "calf")


def _candidate(
    effect: str, where: str, high: float, scale: float, start: float, *, low: float = 0.0
) -> Candidate:
    return Candidate(
        effect=effect,
        where=where,
        unknowns=(Unknown(name=effect, low=low, high=high, scale=scale),),
        starts=((start,),),
    )


def _speed_limit(where: str) -> Candidate:
    """As joints of robots have it; the pendulums reach 10 rad/s."""
    kind = next(kind for kind in KINDS if kind.effect == "torque_speed_limit")
    return replace(kind, where=where, starts=((1.0, 0.0, 12.0), (1.0, 5.0, 5.0)))


def _library(where: str) -> tuple[Candidate, ...]:
    saturation = Candidate(
        effect="torque_saturation",
        where=where,
        unknowns=(
            Unknown(name="loss", low=0.0, high=1.0, scale=0.05),
            Unknown(name="knee", low=2.0, high=20.0, scale=1.0, is_shape=True),
        ),
        starts=((0.2, 5.0), (0.2, 10.0)),
    )
    return (
        _candidate("command_delay", where, 0.03, 0.001, 0.005),
        _candidate("actuator_lag", where, 0.03, 0.001, 0.005),
        _candidate("torque_gain", where, 0.5, 0.02, 0.05, low=-0.5),
        _candidate("viscous_friction", where, 1.0, 0.02, 0.1),
        _candidate("coulomb_friction", where, 2.0, 0.05, 0.2),
        _candidate("armature", where, 0.02, 0.001, 0.005, low=-0.005),
        saturation,
    )


@dataclass(frozen=True)
class Motion:
    """A desired position over time."""

    name: str
    condition: str
    amplitude: float

    def __call__(self, t: Floats) -> Floats:
        if self.condition == "chirp":
            return self.amplitude * np.sin(2.0 * np.pi * (0.3 * t + 0.9 * t**2))
        if self.condition == "triangle":
            return self.amplitude * (2.0 * np.abs(2.0 * ((0.4 * t) % 1.0) - 1.0) - 1.0)
        return self.amplitude * np.clip(15.0 * np.sin(2.0 * np.pi * 0.9 * t), -1.0, 1.0)


MOTIONS = (
    Motion("chirp small", "chirp", 0.2),
    Motion("chirp large", "chirp", 0.4),
    Motion("triangle 1", "triangle", 0.5),
    Motion("triangle 2", "triangle", 0.5),
    Motion("steps 1", "steps", 0.7),
    Motion("steps 2", "steps", 0.7),
)
SEGMENT_S = 4.0


class OneJoint(Problem):
    """Two legs of two joints that nothing couples;
    `hidden` maps (effect, where, block) to unknowns.

    The library has a torque-speed limit if `fast`.
    """

    def __init__(
        self,
        hidden: dict[tuple[str, str, str], tuple[float, ...]],
        *,
        seed: int = 0,
        colour: float = 0.0,
        without: tuple[str, ...] = (),
        ripple: float = 0.0,
        fast: bool = False,
    ) -> None:
        self.name = "joints"
        self.blocks = ("FR", "FL")
        self.places = tuple(
            {where: f"{block}_{where}" for where in WHERES} for block in self.blocks
        )
        self._all = tuple(
            c for w in WHERES for c in (*_library(w), *((_speed_limit(w),) if fast else ()))
        )
        self._fast = fast
        self.candidates = tuple(c for c in self._all if c.effect not in without)
        self.segments = tuple(
            LogSegment(
                name=m.name, start_s=i * SEGMENT_S, end_s=(i + 1) * SEGMENT_S, condition=m.condition
            )
            for i, m in enumerate(MOTIONS)
        )
        self.signals = tuple(f"{kind}_{where}" for where in WHERES for kind in ("q", "dq"))
        self.untestable = {"backlash": "no play in this rig"}
        self._windows = round(SEGMENT_S / WINDOW_S)
        samples = round(WINDOW_S / STEP_S) // ROWS_EVERY
        total = len(MOTIONS) * self._windows * samples
        self.time_s = np.tile(np.arange(total) * STEP_S * ROWS_EVERY, 4)
        self.segment = np.tile(np.repeat(np.arange(len(MOTIONS)), self._windows * samples), 4)
        self.signal = np.repeat(np.arange(4), total)
        truth = np.zeros((1, len(self.blocks), sum(len(c.unknowns) for c in self._all)))
        for (effect, where, block), values in hidden.items():
            truth[0, self.blocks.index(block), self._columns(effect, where)] = values
        rng = np.random.default_rng(seed)
        noise = rng.normal(size=(len(self.blocks), 4, total))
        for k in range(1, total):
            noise[..., k] = colour * noise[..., k - 1] + np.sqrt(1.0 - colour**2) * noise[..., k]
        self._measured = noise.reshape(len(self.blocks), -1) + self._simulate(truth, ripple)[0]

    def residuals(self, unknowns: Floats) -> Floats:
        full = np.zeros((*unknowns.shape[:2], sum(len(c.unknowns) for c in self._all)))
        at = 0
        for candidate in self.candidates:
            columns = self._columns(candidate.effect, candidate.where)
            full[..., columns] = unknowns[..., at : at + len(columns)]
            at += len(columns)
        return np.clip(self._measured - self._simulate(full, 0.0), -100.0, 100.0)

    def _columns(self, effect: str, where: str) -> list[int]:
        at = 0
        for candidate in self._all:
            if (candidate.effect, candidate.where) == (effect, where):
                return list(range(at, at + len(candidate.unknowns)))
            at += len(candidate.unknowns)
        raise KeyError(effect)

    def _simulate(self, unknowns: Floats, ripple: float) -> Floats:
        """Whitened q and dq, shape (n, blocks, m);
        the windows start at rest where the motion is.
        """
        n, blocks, _ = unknowns.shape
        # (n, blocks, joints, windows)
        value = {
            name: np.stack(
                [unknowns[..., self._columns(effect, where)[k]] for where in WHERES], axis=2
            )[..., np.newaxis]
            for name, effect, k in (
                ("delay", "command_delay", 0),
                ("lag", "actuator_lag", 0),
                ("gain", "torque_gain", 0),
                ("viscous", "viscous_friction", 0),
                ("coulomb", "coulomb_friction", 0),
                ("armature", "armature", 0),
                ("loss", "torque_saturation", 0),
                ("knee", "torque_saturation", 1),
                *(
                    (name, "torque_speed_limit", k)
                    for k, name in enumerate(("weight", "corner", "span"))
                    if self._fast
                ),
            )
        }
        starts = np.arange(self._windows) * WINDOW_S
        q = np.concatenate([motion(starts) for motion in MOTIONS]) * np.ones(
            (n, blocks, len(WHERES), 1)
        )
        dq, torque = np.zeros_like(q), np.zeros_like(q)
        steps = round(WINDOW_S / STEP_S)
        kept = np.zeros((2, steps // ROWS_EVERY, *q.shape))
        blend = 1.0 - np.exp(-STEP_S / np.maximum(value["lag"], 1e-6))
        # Few, and the same at most sets
        delays, which = np.unique(value["delay"][..., 0], return_inverse=True)
        t = np.maximum(0.0, starts + STEP_S * np.arange(steps)[:, None, None] - delays[:, None])
        goals = np.concatenate([motion(t) for motion in MOTIONS], axis=-1)
        saturates, rubs = value["loss"].any(), value["coulomb"].any()
        strength, inertia = 1.0 + value["gain"], INERTIA + value["armature"]
        own = 0 if len(delays) == 1 else which  # a view in place of a copy
        for step in range(steps):
            given = KP * (goals[step, own] - q) - KD * dq
            if saturates:
                excess = np.maximum(np.abs(given) - value["knee"], 0.0) * value["loss"]
                given = given - np.sign(given) * excess
            if self._fast:
                share = np.clip(
                    (value["corner"] + value["span"] - np.abs(dq)) / np.maximum(value["span"], 0.1),
                    0.0,
                    1.0,
                )
                cut = np.maximum(0.0, np.sign(dq) * given - STALL * share)
                given = given - value["weight"] * np.sign(dq) * cut
            torque = torque + blend * (strength * given - torque)
            friction = value["viscous"] * dq
            if rubs:
                friction = friction + value["coulomb"] * np.tanh(dq / 0.05)
            total = torque - friction - GRAVITY * np.sin(q)
            if ripple:
                total = total + ripple * np.sin(12.0 * q)
            dq = dq + STEP_S * total / inertia
            q = q + STEP_S * dq
            if step % ROWS_EVERY == ROWS_EVERY - 1:
                kept[0, step // ROWS_EVERY], kept[1, step // ROWS_EVERY] = (
                    q / NOISE_Q,
                    dq / NOISE_DQ,
                )
        # (kind, sample, n, block, joint, window) -> (n, block, joint, kind, window, sample)
        return kept.transpose(2, 3, 4, 0, 5, 1).reshape(n, blocks, -1)
