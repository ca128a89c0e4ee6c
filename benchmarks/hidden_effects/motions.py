"""Motions that the joints are told: segments of a few seconds
that begin and end at rest in the standing pose.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.hidden_effects.robot import STAND, Floats

REST_S = 0.3
REACH = np.tile([0.55, 0.8, 0.6], 4)
"""Largest offset from the standing pose that keeps every joint within its limits, overshoot
included [rad]."""
PUSH = np.tile([3.0, 4.0, 4.0], 4)
"""Largest feed-forward torque [Nm]: kept where the position loop holds the joint near its place."""

Motion = Callable[[Floats, float, np.random.Generator], tuple[Floats, Floats]]
"""From times in a segment (n,) and its length to offsets of joints and of feed-forward torque in
parts of their largest, each (n, 12)."""


@dataclass(frozen=True, kw_only=True)
class Segment:
    """A stretch of a log."""

    name: str
    start_s: float
    end_s: float
    condition: str


def linear_chirp(t: Floats, length: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Sine of rising frequency, smaller as it gets faster."""
    top, phase = rng.uniform(8, 13), rng.uniform(0, 2 * np.pi, 12)
    frequency = 0.2 + (top - 0.2) * t / length
    angle = 2 * np.pi * (0.2 * t + 0.5 * (top - 0.2) * t**2 / length)
    envelope = _window(t, length) / np.maximum(1, frequency / 2.5)
    return 0.5 * envelope[:, None] * np.sin(angle[:, None] + phase), np.zeros((len(t), 12))


def log_chirp(t: Floats, length: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Sine whose frequency grows by a factor per second, falling in every second joint."""
    low, high = 0.3, rng.uniform(9, 15)
    rate = np.log(high / low) / length
    angle = 2 * np.pi * low * (np.exp(rate * t) - 1) / rate
    frequency = low * np.exp(rate * t)
    envelope = _window(t, length) / np.maximum(1, frequency / 2.5)
    rising = envelope * np.sin(angle)
    falling = np.where(np.arange(12) % 2 == 0, 1, -1)
    return 0.5 * rising[:, None] * falling * rng.uniform(0.7, 1, 12), np.zeros((len(t), 12))


def triangle(t: Floats, length: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Slow ramps up and down."""
    cycles = rng.integers(1, 3)
    x = cycles * t / length
    wave = 2 * np.abs(2 * ((x + 0.25) % 1) - 1) - 1
    return -0.45 * wave[:, None] * rng.choice([-1, 1], 12), np.zeros((len(t), 12))


def wander(t: Floats, length: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """A sum of slow sines that have no common period."""
    total = np.zeros((len(t), 12))
    for _ in range(4):
        total += np.sin(
            2 * np.pi * rng.uniform(0.15, 1.1, 12) * t[:, None] + rng.uniform(0, 2 * np.pi, 12)
        )
    return 0.18 * _window(t, length)[:, None] * total, np.zeros((len(t), 12))


def steps(t: Floats, length: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Jumps there and back."""
    hold = rng.uniform(0.35, 0.55)
    level = np.array([0.0, 1.0, 0.0, -1.0])[(t / hold).astype(int) % 4]
    level = np.where(t > length - 0.4, 0.0, level)
    return 0.6 * level[:, None] * rng.choice([-1, 1], 12), np.zeros((len(t), 12))


def random_steps(t: Floats, length: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Jumps to levels drawn anew each time, each joint at its own moments."""
    out = np.zeros((len(t), 12))
    for joint in range(12):
        edges = np.cumsum(rng.uniform(0.2, 0.6, 40))
        levels = rng.uniform(-0.5, 0.5, 41)
        out[:, joint] = levels[np.searchsorted(edges, t)]
    out[(t > length - 0.4) | (t < 0.1)] = 0.0
    return out, np.zeros((len(t), 12))


def hold_ladder(t: Floats, length: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Rungs that are held, reached by short ramps."""
    rungs = np.concatenate([[0.0], rng.permutation([-0.8, -0.4, 0.4, 0.8]), [0.0]])
    x = t / length * (len(rungs) - 1)
    eased = _ramped(x, rungs)
    return eased[:, None] * rng.choice([-1, 1], 12), np.zeros((len(t), 12))


def torque_stairs(t: Floats, length: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Feed-forward torque in stairs, against the position loop."""
    count = 6
    levels = np.concatenate([[0.0], rng.uniform(-1, 1, count - 2), [0.0]])
    push = levels[np.minimum((t / length * count).astype(int), count - 1)]
    return np.zeros((len(t), 12)), push[:, None] * rng.choice([-1, 1], 12)


def torque_sweep(t: Floats, length: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Feed-forward torque as a square wave that gets faster."""
    angle = 2 * np.pi * (0.7 * t + 0.5 * rng.uniform(0.8, 1.6) * t**2)
    push = (
        np.sign(np.sin(angle[:, None] + rng.uniform(0, 2 * np.pi, 12)))
        * (t < length - 0.3)[:, None]
    )
    return np.zeros((len(t), 12)), 0.8 * push


def bits(t: Floats, length: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Small jumps at random moments in both directions: all frequencies at once."""
    slots = (t / 0.06).astype(int)
    levels = rng.choice([-1.0, 1.0], (slots[-1] + 1, 12))
    return 0.16 * levels[slots] * (t < length - 0.3)[:, None], np.zeros((len(t), 12))


def sine(t: Floats, length: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """One frequency."""
    frequency = rng.uniform(0.7, 1.4)
    wave = np.sin(2 * np.pi * frequency * t[:, None] + rng.uniform(0, 2 * np.pi, 12))
    return 0.5 * _window(t, length)[:, None] * wave, np.zeros((len(t), 12))


TUNING: dict[str, Motion] = {
    "chirp": linear_chirp,
    "triangle": triangle,
    "steps": steps,
    "ladder": hold_ladder,
    "stairs": torque_stairs,
    "sine": sine,
}
SEALED: dict[str, Motion] = {
    "sweep": log_chirp,
    "wander": wander,
    "jumps": random_steps,
    "rungs": hold_ladder,
    "pushes": torque_sweep,
    "bits": bits,
}
JUMPS = (steps, random_steps, bits)
QUIET: dict[str, Motion] = {"sine": sine, "wander": wander}


def commands(
    rng: np.random.Generator, *, control_dt: float, length_s: float, tuning: bool, quiet: bool
) -> tuple[Floats, tuple[Segment, ...]]:
    """Desired position, desired velocity and feed-forward torque,
    shape (rows, 12, 3), and the segments of a log.
    """
    chosen = _choose(rng, tuning, quiet)
    repeats = 4 if quiet else 2
    plan = [
        (name, number) for name in chosen for number in range(repeats + int(rng.uniform() < 0.4))
    ]
    rng.shuffle(plan)
    rows = round(length_s / len(plan) / control_dt)
    seeds = {name: int(rng.integers(2**31)) for name in chosen}
    library = QUIET if quiet else TUNING if tuning else SEALED
    parts, segments = [], []
    for place, (name, number) in enumerate(plan):
        size = (0.15 if quiet else 1.0) * (1.0, 1.0, 0.6, 0.8, 1.0)[number]
        motion = library[name]
        rng_again = np.random.default_rng(seeds[name])
        parts.append(segment(motion, rows, control_dt, size, rng_again, jumps=motion in JUMPS))
        start, end = place * rows * control_dt, (place + 1) * rows * control_dt
        segments.append(Segment(name=f"{name}-{number}", start_s=start, end_s=end, condition=name))
    return np.concatenate(parts), tuple(segments)


def _choose(rng: np.random.Generator, tuning: bool, quiet: bool) -> list[str]:
    """Names of the conditions of a log: with large steps and pushes always,
    as most effects need one of them.
    """
    if quiet:
        return list(QUIET)
    always, others = (
        (["steps", "stairs"], ["chirp", "triangle", "ladder", "sine"])
        if tuning
        else (
            ["jumps", "pushes"],
            ["sweep", "wander", "rungs", "bits"],
        )
    )
    return [*always, *rng.permutation(others)[: rng.integers(2, 4)].tolist()]


def segment(
    motion: Motion, rows: int, dt: float, size: float, rng: np.random.Generator, *, jumps: bool
) -> Floats:
    """Commands of one segment, shape (rows, 12, 3); what jumps is commanded without a velocity."""
    length = rows * dt - REST_S
    t = np.arange(rows) * dt
    moving = t < length
    offset, push = motion(t[moving], length, rng)
    position = np.tile(STAND, (rows, 1))
    position[moving] += size * REACH * offset
    forward = np.zeros((rows, 12))
    forward[moving] = size * PUSH * push
    velocity = np.gradient(position, dt, axis=0)
    if jumps:
        velocity[:] = 0.0
    return np.stack([position, velocity, forward], axis=-1)


def _window(t: Floats, length: float) -> Floats:
    edge = 0.3
    return np.asarray(np.clip(np.minimum(t, length - t) / edge, 0, 1), dtype=float)


def _ramped(x: Floats, rungs: Floats) -> Floats:
    """Rung of a ladder at `x` in units of rungs.

    The first 30 % of each is the way up from the one before.
    """
    number = np.minimum(x.astype(int), len(rungs) - 2)
    part = np.clip((x - number) / 0.3, 0, 1)
    return np.asarray(rungs[number] + (rungs[number + 1] - rungs[number]) * part, dtype=float)
