"""Which runs there are: drawn once from a seed, balanced over effects."""

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import numpy as np

from benchmarks.hidden_effects.damage import DAMAGES

Kind = Literal["joints", "camera", "body", "imu"]
Category = Literal["none", "one", "two", "play", "outside", "damaged"]

KINDS: dict[Kind, float] = {"joints": 0.55, "camera": 0.25, "body": 0.12, "imu": 0.08}
Part = Literal["all", "pairs_and_play"]
"""Which runs there are: of all kinds, or those of joints that tell pairs and play."""
Name = TypeVar("Name", bound=str)

CATEGORIES: dict[Category, float] = {
    "none": 0.20,
    "one": 0.45,
    "two": 0.20,
    "outside": 0.10,
    "damaged": 0.05,
}
PAIRS_AND_PLAY: dict[Category, float] = {"none": 0.27, "one": 0.32, "two": 0.27, "play": 0.14}
"""Shares in the set `pairs_and_play`; play is backlash alone, of a width that is told and not of so
many sigmas."""
WIDTHS = (0.016, 0.02, 0.026, 0.035)
"""Full widths of play [rad]: 0.9 to 2 degrees, of a linkage that is worn."""
QUIET_PART = 0.12
"""Part of the runs with one effect whose motion is too small to show most effects."""
MULTIPLES = (1.5, 3.0, 8.0)

LIBRARY: dict[Kind, tuple[str, ...]] = {
    "joints": (
        "torque_saturation", "torque_speed_limit", "command_delay", "feedforward_delay",
        "actuator_lag", "torque_gain",
        "viscous_friction", "coulomb_friction", "stiction", "backlash", "armature", "battery_sag",
        "encoder_bias",
        "encoder_quantisation", "velocity_filter", "velocity_scale", "joint_spring",
    ),
    "camera": (
        "camera_latency", "frame_drop", "temporal_smear", "camera_pitch", "camera_height",
        "camera_fov", "depth_scale",
        "depth_bias", "depth_noise", "edge_holes", "hole_fill", "range_clip",
    ),
    "body": ("payload_mass", "com_offset", "base_inertia", "foot_friction", "contact_compliance"),
    "imu": ("imu_bias", "imu_latency"),
}  # fmt: skip
CONFUSABLE: dict[Kind, tuple[tuple[str, str], ...]] = {
    "joints": (
        ("command_delay", "actuator_lag"), ("torque_gain", "armature"),
        ("coulomb_friction", "backlash"),
        ("torque_saturation", "torque_speed_limit"), ("battery_sag", "torque_gain"),
        ("stiction", "coulomb_friction"),
        ("viscous_friction", "coulomb_friction"), ("velocity_filter", "command_delay"),
        ("encoder_bias", "torque_gain"),
        ("feedforward_delay", "command_delay"), ("torque_saturation", "torque_gain"),
        ("armature", "actuator_lag"),
        ("joint_spring", "encoder_bias"), ("velocity_scale", "viscous_friction"),
    ),
    "camera": (
        ("camera_latency", "temporal_smear"), ("depth_scale", "camera_height"),
        ("camera_pitch", "camera_fov"),
        ("depth_bias", "depth_scale"), ("camera_pitch", "camera_height"),
        ("edge_holes", "hole_fill"),
        ("frame_drop", "camera_latency"), ("depth_noise", "depth_bias"),
    ),
    "body": (("payload_mass", "com_offset"), ("payload_mass", "contact_compliance"),
        ("com_offset", "base_inertia")),
    "imu": (("imu_bias", "imu_latency"),),
}  # fmt: skip
TUNING_OUTSIDE: dict[Kind, tuple[str, ...]] = {
    "joints": (
        "cogging", "kp_slope", "asymmetric_gain", "hum", "coupling", "flexible_gear", "heating",
    ),
    "camera": ("rolling_shutter", "depth_ripple", "tilt_drift", "skewed_depth"),
    "body": ("side_wind", "hidden_bump"),
    "imu": ("gyro_scale", "acc_hum"),
}  # fmt: skip
SEALED_OUTSIDE: dict[Kind, tuple[str, ...]] = {
    "joints": ("integral_term", "rubbing_spot", "dropouts", "eccentric_encoder"),
    "camera": ("rolled_camera", "column_pattern", "breathing_scale", "soft_mount"),
    "body": ("loose_load", "nudges"),
    "imu": ("gyro_cross", "attitude_wander"),
}
"""Never used in tuning."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """One run as planned; what else it has is drawn from its seed."""

    name: str
    """Name of the log's directory: says nothing."""
    kind: Kind
    category: Category
    effects: tuple[str, ...]
    multiples: tuple[float, ...]
    """Wanted sizes of the effects in units of their one-sigma size."""
    sizes: tuple[float, ...] = ()
    """Their sizes, where those are told instead."""
    quiet: bool
    damage: str
    seed: int


def make_plan(
    seed: int,
    count: int,
    kinds: tuple[Kind, ...] = tuple(KINDS),
    *,
    tuning: bool = False,
    part: Part = "all",
) -> tuple[Run, ...]:
    """Plans `count` runs, in an order that says nothing.

    Of `pairs_and_play` joints alone, none quiet or damaged.
    """
    outside = TUNING_OUTSIDE if tuning else SEALED_OUTSIDE
    rng = np.random.default_rng(seed)
    of_all = CATEGORIES if part == "all" else PAIRS_AND_PLAY
    kinds = kinds if part == "all" else ("joints",)
    categories = _split(of_all, count, rng)
    runs = []
    effects = _Deck(rng)
    for category in of_all:
        wanted = categories.count(category)
        shares = {
            kind: KINDS[kind]
            for kind in kinds
            if category != "damaged" or kind in ("joints", "body")
        }
        for number, kind in enumerate(_split(shares, wanted, rng)):
            runs.append(_run(category, kind, number, outside[kind], effects, rng))
    if part != "all":
        runs = [_told(run, effects) for run in runs]
    return tuple(runs[i] for i in rng.permutation(len(runs)))


class _Deck:
    """Deals names so that each comes equally often."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._decks: dict[tuple[str, ...], Iterator[object]] = {}

    def deal(self, *key: str, cards: tuple[object, ...]) -> object:
        if key not in self._decks:
            order = self._rng.permutation(len(cards))
            self._decks[key] = itertools.cycle([cards[i] for i in order])
        return next(self._decks[key])


def _run(
    category: Category,
    kind: Kind,
    number: int,
    outside: tuple[str, ...],
    deck: _Deck,
    rng: np.random.Generator,
) -> Run:
    effects: tuple[str, ...] = ()
    damage = ""
    if category == "one":
        effects = (str(deck.deal("one", kind, cards=LIBRARY[kind])),)
    elif category == "two":
        pairs: tuple[object, ...] = CONFUSABLE[kind]
        if number % 2 and len(LIBRARY[kind]) > 2:
            pairs = tuple(itertools.combinations(LIBRARY[kind], 2))
        effects = tuple(deck.deal("two", kind, str(number % 2), cards=pairs))  # type: ignore[arg-type]
    elif category == "outside":
        effects = (str(deck.deal("outside", kind, cards=outside)),)
    elif category == "damaged":
        damage = str(deck.deal("damaged", cards=DAMAGES))
    multiples = MULTIPLES if category == "one" else MULTIPLES[1:]
    return Run(
        name=rng.bytes(6).hex(),
        kind=kind,
        category=category,
        effects=effects,
        multiples=tuple(
            float(str(deck.deal(category, "size", effect, cards=multiples))) for effect in effects
        ),
        quiet=category == "one"
        and kind == "joints"
        and rng.uniform() < QUIET_PART / KINDS["joints"],
        damage=damage,
        seed=int(rng.integers(2**31)),
    )


def _told(run: Run, deck: _Deck) -> Run:
    """A run of `pairs_and_play`: effects of three sigmas or more,
    and play of a width of its own.
    """
    if run.category == "play":
        width = float(str(deck.deal("width", cards=WIDTHS)))
        return replace(
            run, effects=("backlash",), multiples=(MULTIPLES[-1],), sizes=(width,), quiet=False
        )
    return replace(run, multiples=tuple(max(m, MULTIPLES[1]) for m in run.multiples), quiet=False)


def _split(shares: Mapping[Name, float], count: int, rng: np.random.Generator) -> list[Name]:
    """Names in shares of a whole, rounded so that they sum up to `count`, shuffled."""
    names = list(shares)
    wanted = np.array([shares[name] for name in names])
    exact = wanted / wanted.sum() * count
    counts = np.floor(exact).astype(int)
    for i in np.argsort(counts - exact)[: count - counts.sum()]:
        counts[i] += 1
    return [names[i] for i in rng.permutation(np.repeat(np.arange(len(names)), counts))]
