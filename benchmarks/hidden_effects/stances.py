"""Motions that a standing robot is told: segments that begin and end in the standing pose."""

from collections.abc import Callable

import numpy as np

from benchmarks.hidden_effects.motions import Segment
from benchmarks.hidden_effects.robot import FRONT, SIDE, STAND, Floats

EASE_S = 0.4
HOPS = 0.4
"""Part of the runs in which the robot leaves the ground."""
Stance = Callable[[Floats, Floats, np.random.Generator], Floats]
"""From times in a segment and an envelope to offsets of the joints, (n, 12)."""


def _legs(hip: Floats, fold: Floats, swing: Floats) -> Floats:
    """Offsets of joints from those of abduction,
    of folding (body down) and of swing, each (n, 4).
    """
    return np.stack([hip, fold + swing, -2 * fold], axis=-1).reshape(len(hip), 12)


def hold(t: Floats, envelope: Floats, rng: np.random.Generator) -> Floats:
    """Stands."""
    del envelope, rng
    return np.zeros((len(t), 12))


def squat(t: Floats, envelope: Floats, rng: np.random.Generator) -> Floats:
    """Body down and up."""
    wave = np.sin(2 * np.pi * rng.uniform(0.8, 1.6) * t) * envelope
    return _legs(np.zeros((len(t), 4)), 0.18 * wave[:, None] * np.ones(4), np.zeros((len(t), 4)))


def rock(t: Floats, envelope: Floats, rng: np.random.Generator) -> Floats:
    """Nods faster and faster."""
    rise = (rng.uniform(1.6, 2.0) - 0.5) / t[-1]
    wave = np.sin(2 * np.pi * (0.5 * t + 0.5 * rise * t**2)) * envelope
    return _legs(
        np.zeros((len(t), 4)), 0.07 * wave[:, None] * np.array(FRONT), np.zeros((len(t), 4))
    )


def roll(t: Floats, envelope: Floats, rng: np.random.Generator) -> Floats:
    """Leans to the sides and turns about its length."""
    wave = np.sin(2 * np.pi * rng.uniform(0.8, 1.8) * t) * envelope
    return _legs(
        0.08 * wave[:, None] * np.ones(4),
        0.04 * wave[:, None] * np.array(SIDE),
        np.zeros((len(t), 4)),
    )


def sway(t: Floats, envelope: Floats, rng: np.random.Generator) -> Floats:
    """Body forth and back."""
    rate = rng.uniform(1.3, 1.7)
    wave = np.sin(2 * np.pi * rate * t) * envelope
    swing = 0.08 * wave[:, None] * np.ones(4)
    return _legs(np.zeros((len(t), 4)), np.zeros((len(t), 4)), swing)


def mixture(t: Floats, envelope: Floats, rng: np.random.Generator) -> Floats:
    """Several of these at once, at frequencies without a common period."""
    waves = [
        np.sin(2 * np.pi * f * t + p)
        for f, p in zip(rng.uniform(0.4, 2.2, 4), rng.uniform(0, 6.28, 4), strict=True)
    ]
    squat_, nod, lean, shift = (wave[:, None] * envelope[:, None] for wave in waves)
    ones = np.ones(4)
    return _legs(
        0.06 * lean * ones, 0.08 * squat_ * ones + 0.04 * nod * np.array(FRONT), 0.04 * shift * ones
    )


def hop(t: Floats, envelope: Floats, rng: np.random.Generator) -> Floats:
    """Folds slowly, stretches at once, lands; again and again."""
    del envelope
    period = rng.uniform(0.9, 1.1)
    phase = t % period
    fold = np.interp(phase, [0.0, 0.4, 0.5, 0.6, 0.7, period], [0.0, 0.2, -0.1, -0.1, 0.04, 0.0])
    fold = np.where(t // period < t[-1] // period, fold, 0.0)
    return _legs(np.zeros((len(t), 4)), fold[:, None] * np.ones(4), np.zeros((len(t), 4)))


TUNING: dict[str, Stance] = {"hold": hold, "squat": squat, "rock": rock, "sway": sway, "hop": hop}
SEALED: dict[str, Stance] = {
    "still": hold,
    "blend": mixture,
    "lean": roll,
    "shift": sway,
    "leap": hop,
    "nod": rock,
}


def commands(
    rng: np.random.Generator, *, control_dt: float, tuning: bool
) -> tuple[Floats, Floats, tuple[Segment, ...]]:
    """Desired positions and velocities, (rows, 12) each, and segments: every motion twice."""
    library = TUNING if tuning else SEALED
    names = [name for name in library if library[name] is not hop or rng.uniform() < HOPS]
    order = [(name, number) for name in names for number in range(2)]
    rng.shuffle(order)
    rows = round(rng.uniform(20, 24) / len(order) / control_dt)
    seeds = {name: int(rng.integers(2**31)) for name in names}
    parts, segments = [], []
    for place, (name, number) in enumerate(order):
        size = 1.0 if number == 0 else 0.8
        rng_again = np.random.default_rng(seeds[name])
        parts.append(stretch(library[name], rows, control_dt, rng_again, size))
        start = place * rows * control_dt
        segments.append(
            Segment(
                name=f"{name}-{number}",
                start_s=start,
                end_s=start + rows * control_dt,
                condition=name,
            )
        )
    position = np.concatenate(parts)
    return position, np.gradient(position, control_dt, axis=0), tuple(segments)


def stretch(
    stance: Stance, rows: int, control_dt: float, rng: np.random.Generator, size: float = 1.0
) -> Floats:
    """Desired positions of one segment, (rows, 12)."""
    t = np.arange(rows) * control_dt
    ease = np.clip(np.minimum(t, t[-1] - t) / EASE_S, 0, 1)
    return np.asarray(STAND + size * stance(t, ease * ease * (3 - 2 * ease), rng))
