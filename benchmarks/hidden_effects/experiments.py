"""Experiments that a robot can be asked for next, by name, as motions of this package."""

from collections.abc import Callable

import numpy as np

from benchmarks.hidden_effects import motions, stances, view
from benchmarks.hidden_effects.motions import Motion, Segment
from benchmarks.hidden_effects.robot import Floats
from benchmarks.hidden_effects.stances import Stance

REPEATS = 2
PULSE_S, PULSE_EVERY_S = 0.1, 0.6
LARGEST_PULSE = 4.0
"""Largest pulse of the ladder of torques, in parts of what is held for long: a pulse is over before
the joint has gone far."""
KNOWN_PAYLOAD_KG = 2.0
RELEASE_M = 0.08
"""Height of the feet above the floor from which the robot is let fall."""


def _levels(*levels: float, hold_s: float) -> Motion:
    def motion(t: Floats, length: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
        level = np.array(levels)[(t / hold_s).astype(int) % len(levels)]
        level = np.where(t > length - 0.4, 0.0, level)
        return level[:, None] * rng.choice([-1, 1], 12), np.zeros((len(t), 12))

    return motion


def _triangle(cycles: int) -> Motion:
    def motion(t: Floats, length: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
        wave = 2 * np.abs(2 * ((cycles * t / length + 0.25) % 1) - 1) - 1
        return -0.5 * wave[:, None] * rng.choice([-1, 1], 12), np.zeros((len(t), 12))

    return motion


def _sine(t: Floats, length: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    ease = np.clip(np.minimum(t, length - t) / 0.3, 0, 1)
    wave = ease * np.sin(2 * np.pi * t)
    return 0.5 * wave[:, None] * rng.choice([-1, 1], 12), np.zeros((len(t), 12))


def _pulses(t: Floats, length: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    number = (t / PULSE_EVERY_S).astype(int)
    count = max(number[-1], 1)
    size = LARGEST_PULSE * np.minimum((number + 1) / count, 1.0) * np.where(number % 2 == 0, 1, -1)
    on = (t % PULSE_EVERY_S < PULSE_S) & (t < length - PULSE_EVERY_S)
    return np.zeros((len(t), 12)), (size * on)[:, None] * rng.choice([-1, 1], 12)


SMALL_STEPS, SMALLER_STEPS = (
    _levels(0.0, 0.5, 0.0, -0.5, hold_s=0.5),
    _levels(0.0, 0.14, 0.0, -0.14, hold_s=0.5),
)
LARGE_STEPS, LARGEST_STEPS = _levels(0.5, -0.5, hold_s=0.5), _levels(0.95, -0.95, hold_s=0.6)
JUMPS = (SMALL_STEPS, SMALLER_STEPS, LARGE_STEPS, LARGEST_STEPS)
JOINTS: dict[str, tuple[dict[str, Motion], float]] = {
    "joint_tour": (
        {"chirp": motions.linear_chirp, "slow": _triangle(1), "step": LARGE_STEPS,
            "hold": motions.hold_ladder}, 32.0
    ),
    "joint_chirp": ({"chirp": motions.linear_chirp, "log chirp": motions.log_chirp}, 24.0),
    "joint_chirp_kp2": ({"chirp": motions.linear_chirp, "log chirp": motions.log_chirp}, 24.0),
    "single_sine": ({"sine": _sine}, 16.0),
    "slow_triangle": ({"slow": _triangle(1), "faster": _triangle(3)}, 32.0),
    "small_steps": ({"small": SMALL_STEPS, "smaller": SMALLER_STEPS}, 16.0),
    "large_steps": ({"large": LARGE_STEPS, "largest": LARGEST_STEPS}, 20.0),
    "hold_ladder": ({"rungs": motions.hold_ladder}, 18.0),
    "torque_ladder": ({"pulses": _pulses, "stairs": motions.torque_stairs}, 24.0),
}  # fmt: skip
"""By name of an experiment: its motions by condition, and its length [s]."""
STIFFER = {"joint_chirp_kp2": 2.0}
"""Factor of the stiffness; that of damping is its root."""

CAMERA: dict[str, tuple[tuple[str, ...], float, str]] = {
    "heave_and_pitch": (("heave chirp", "pitch chirp"), 26.0, "step"),
    "pitch_rocking": (("pitch 1 Hz", "pitch 2 Hz"), 16.0, "step"),
    "heave_sine": (("heave 1 Hz",), 15.0, "step"),
    "height_step": (("at 0.4 m", "at 0.6 m", "at 0.8 m"), 15.0, "step"),
    "wall_two_ranges": (("at 0.7 m", "at 1.4 m"), 10.0, "wall"),
}
"""By name of an experiment: its conditions, its length [s], and what stands before the robot."""
NOSE_M = 0.27
"""From the trunk's centre to the camera: ranges are counted from there."""
WALK_S = 0.7
"""In which the robot gets from one place to the next, before the segment of that place begins: up
to 1 m/s."""

BODY: dict[str, tuple[dict[str, Stance], float]] = {
    "heave_and_pitch": ({"heave": stances.squat, "pitch": stances.rock}, 26.0),
    "pitch_rocking": ({"pitch": stances.rock}, 16.0),
    "heave_sine": ({"heave": stances.squat}, 15.0),
    "squat": ({"squat": stances.squat, "still": stances.hold}, 20.0),
    "stand_with_payload": ({"squat": stances.squat, "still": stances.hold}, 16.0),
    "drop": ({"fall": stances.hold, "leap": stances.hop}, 12.0),
}
PAYLOAD_KG = {"stand_with_payload": KNOWN_PAYLOAD_KG}
RELEASE = {"drop": RELEASE_M}


def joint_commands(
    name: str, control_dt: float, rng: np.random.Generator
) -> tuple[Floats, tuple[Segment, ...]]:
    """As `motions.commands`, for an experiment."""
    table, length = JOINTS[name]
    rows = round(length / (REPEATS * len(table)) / control_dt)
    parts: list[Floats] = []
    segments: list[Segment] = []
    for condition, motion in table.items():
        seed = int(rng.integers(2**31))
        for number in range(REPEATS):
            again = np.random.default_rng(seed)
            parts.append(
                motions.segment(motion, rows, control_dt, 1.0, again, jumps=motion in JUMPS)
            )
            segments.append(
                _segment(condition, number, len(segments) * rows * control_dt, rows * control_dt)
            )
    return np.concatenate(parts), tuple(segments)


def body_commands(
    name: str, control_dt: float, rng: np.random.Generator
) -> tuple[Floats, tuple[Segment, ...]]:
    """Desired positions, (rows, 12), and segments of an experiment."""
    table, length = BODY[name]
    # what begins with a fall falls once
    order = [
        (condition, n) for condition in table for n in range(1 if condition == "fall" else REPEATS)
    ]
    rows = round(length / len(order) / control_dt)
    seeds = {condition: int(rng.integers(2**31)) for condition in table}
    parts: list[Floats] = []
    segments: list[Segment] = []
    for condition, number in order:
        again = np.random.default_rng(seeds[condition])
        parts.append(stances.stretch(table[condition], rows, control_dt, again))
        segments.append(
            _segment(condition, number, len(segments) * rows * control_dt, rows * control_dt)
        )
    return np.concatenate(parts), tuple(segments)


def camera_path(name: str) -> tuple[view.Path, tuple[view.Box, ...]]:
    """Motion of the trunk and what stands before it in an experiment."""
    conditions, length, before = CAMERA[name]
    each = length / (REPEATS * len(conditions))
    t = np.arange(0, length + 0.5, 1e-3)
    values = np.zeros((3, len(t)))
    segments = []
    for number, condition in enumerate(c for c in conditions for _ in range(REPEATS)):
        inside = (t >= number * each) & (t < (number + 1) * each)
        values[:, inside] = _camera_move(condition, t[inside] - number * each, each, before)
        walk = WALK_S if condition.startswith("at ") else 0.0
        if walk and number:
            done = np.clip((t[inside] - number * each) / walk, 0, 1)
            came_from = values[0, inside.argmax() - 1]
            values[0, inside] = came_from + (values[0, inside] - came_from) * done * done * (
                3 - 2 * done
            )
        segments.append(_segment(condition, number % REPEATS, number * each + walk, each - walk))
    boxes = {
        "step": (
            view.Box(center=(1.05, 0.0, 0.05), size=(0.5, 1.2, 0.1)),
            view.Box(center=(1.8, 0.0, 0.1), size=(1.0, 1.2, 0.2)),
        ),
        "wall": (view.Box(center=(1.65, 0.0, 1.0), size=(0.1, 4.0, 2.0)),),
    }
    return view.path_of(t, values, tuple(segments)), boxes[before]


def _camera_move(condition: str, t: Floats, length: float, before: str) -> Floats:
    """Offsets of x, z and pitch, shape (3, n)."""
    ease = np.clip(np.minimum(t, length - t) / view.REST_S, 0, 1)
    ease = ease * ease * (3 - 2 * ease)
    zero = np.zeros_like(t)
    if condition.startswith("at "):  # the robot stands there for the whole segment
        face = 0.8 if before == "step" else 1.6
        return np.stack([face - NOSE_M - float(condition.split()[1]) + zero, zero, zero])
    top = 5.0
    frequency = 0.3 + (top - 0.3) * t / length
    sweep = np.sin(2 * np.pi * (0.3 * t + 0.5 * (top - 0.3) * t**2 / length)) / np.maximum(
        1.0, frequency / 1.5
    )
    moves: dict[str, Callable[[], list[Floats]]] = {
        "heave chirp": lambda: [zero, 0.03 * sweep, zero],
        "pitch chirp": lambda: [zero, zero, 0.1 * sweep],
        "pitch 1 Hz": lambda: [zero, zero, 0.1 * np.sin(2 * np.pi * t)],
        "pitch 2 Hz": lambda: [zero, zero, 0.06 * np.sin(4 * np.pi * t)],
        "heave 1 Hz": lambda: [zero, 0.03 * np.sin(2 * np.pi * t), zero],
    }
    return np.asarray(ease * np.stack(moves[condition]()))


def _segment(condition: str, number: int, start: float, length: float) -> Segment:
    return Segment(
        name=f"{condition}-{number}", start_s=start, end_s=start + length, condition=condition
    )
