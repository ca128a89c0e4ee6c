"""Four legs held at their base: from commands and what is hidden to what the drives would log."""

from dataclasses import dataclass, field
from functools import cache

import numpy as np
import warp as wp

from benchmarks.hidden_effects import leg_kernel
from benchmarks.hidden_effects.leg_kernel import COLUMN, CURVE_POINTS, STEP_S
from benchmarks.hidden_effects.robot import (
    ABDUCTION,
    ARMATURE,
    SIDE,
    STAND,
    TORQUE_LIMIT,
    Floats,
    leg_links,
)

LATE = 2.0
"""By how many of its usual times on its way a packet is later than usual that comes late."""
BEND = 6.0e-5
"""Until a bristle of dry friction gives way, unless an effect says more [rad]: far less than an
encoder sees."""


@dataclass(frozen=True, kw_only=True)
class PacketTiming:
    """When packets arrive.

    They keep their order, so that one that is late holds up those behind it.
    """

    jitter: float = 0.05
    """Standard deviation of a packet's time on its way, as a part of it."""
    late: float = 0.0
    """Share of packets that come late."""
    is_whole: bool = False
    """True where they are handed over in whole periods of the commands only."""


@dataclass(frozen=True, kw_only=True)
class Rig:
    """Commands, and how fast the drives work."""

    command: Floats
    """Desired position, desired velocity, feed-forward torque; shape (rows, 12, 3)."""
    kp: Floats
    kd: Floats
    control_dt: float
    tick_steps: int
    """Steps of 0.125 ms between two evaluations of the PD law."""


@dataclass(frozen=True, kw_only=True)
class Hidden:
    """How the drives of one variant differ from the claim; arrays of shape (12,)."""

    values: dict[str, Floats] = field(default_factory=dict)
    """By name of a column of the kernel's table."""
    command_delay: Floats | None = None
    forward_delay: Floats | None = None
    command_way: PacketTiming = PacketTiming()
    forward_way: PacketTiming = PacketTiming()
    curve: Floats | None = None
    """Torque lost at equal steps of the command up to the joint's limit, shape (12, 37)."""


def simulate(
    rig: Rig, variants: list[Hidden], legs: tuple[int, ...] = (0, 1, 2, 3), seed: int = 0
) -> Floats:
    """Measured without noise: position, velocity, believed torque.

    Shape (variants, rows, 12, 3).
    """
    rows = len(rig.command)
    steps = round(rig.control_dt / STEP_S)
    out = np.zeros((len(variants), rows, 12, 3), dtype=np.float32)
    arrivals = [_arrivals(rows, steps, hidden, seed) for hidden in variants]
    device = "cpu"
    result = wp.array(out, dtype=float, device=device)
    wp.launch(
        leg_kernel.simulate,
        dim=(len(variants), len(legs)),
        inputs=[
            wp.array(np.array(legs, dtype=np.int32), dtype=int, device=device),
            _legs(),
            wp.array(rig.command.astype(np.float32), dtype=float, device=device),
            wp.array(np.stack([a for a, _ in arrivals]), dtype=int, device=device),
            wp.array(np.stack([b for _, b in arrivals]), dtype=int, device=device),
            wp.array(np.stack([_table(hidden) for hidden in variants]), dtype=float, device=device),
            wp.array(np.stack([_curve(hidden) for hidden in variants]), dtype=float, device=device),
            wp.array(np.stack([rig.kp, rig.kd]).astype(np.float32), dtype=float, device=device),
            wp.array(STAND.astype(np.float32), dtype=float, device=device),
            steps,
            rig.tick_steps,
        ],
        outputs=[result],
        device=device,
    )
    return np.asarray(result.numpy(), dtype=np.float64)


def mean_delay(rig: Rig, hidden: Hidden, seed: int = 0) -> tuple[Floats, Floats]:
    """Mean time [s] from the sending of a packet to its first use by a drive,
    for commands and feed-forward; (12,).
    """
    rows, steps = len(rig.command), round(rig.control_dt / STEP_S)
    sent = np.arange(rows) * steps
    late = [
        (arrival - sent)[:, 1:].mean(axis=1) * STEP_S
        for arrival in _arrivals(rows, steps, hidden, seed)
    ]
    return late[0], late[1] - late[0]


def _arrivals(rows: int, steps: int, hidden: Hidden, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Step at which each packet has arrived, and at which its feed-forward part may be used.

    Int32 (12, rows).
    """
    rng = np.random.default_rng(seed)
    sent = np.arange(rows) * steps
    total = np.zeros((12, rows))
    arrival = np.tile(sent, (12, 1))
    results = []
    # rounded up or down by chance: otherwise a delay would come in whole steps
    chance = rng.uniform(size=rows)
    ways = (hidden.command_delay, hidden.command_way), (hidden.forward_delay, hidden.forward_way)
    for delay, way in ways:
        spread, is_late = rng.normal(size=rows), rng.uniform(size=rows) < way.late
        if delay is not None:
            total = total + np.maximum(
                delay[:, None] * (1 + way.jitter * spread + LATE * is_late), 0.0
            )
            grain = steps if way.is_whole else 1
            own = np.maximum.accumulate(
                sent + grain * np.floor(total / (grain * STEP_S) + chance), axis=1
            )
            arrival = np.maximum(arrival, own)  # no part of a packet is there before the packet
        arrival[:, 0] = 0
        results.append(arrival.astype(np.int32))
    return results[0], results[1]


def _table(hidden: Hidden) -> np.ndarray:
    table = np.zeros((12, len(COLUMN)), dtype=np.float32)
    table[:, [COLUMN["gain"], COLUMN["speed_scale"]]] = 1.0
    table[:, COLUMN["armature"]] = ARMATURE
    table[:, COLUMN["stribeck_velocity"]] = 0.1
    table[:, COLUMN["presliding"]] = BEND
    table[:, COLUMN["torque_limit"]] = TORQUE_LIMIT
    for name, values in hidden.values.items():
        added = ARMATURE if name == "armature" else 0.0
        table[:, COLUMN[name]] = values + added
    return table


def _curve(hidden: Hidden) -> np.ndarray:
    curve = np.zeros((12, CURVE_POINTS)) if hidden.curve is None else hidden.curve
    return curve.astype(np.float32)


@cache
def _legs() -> wp.array:
    legs = []
    for number in range(4):
        masses, centres, inertias = leg_links(number)
        leg = leg_kernel.Leg()
        leg.mass = wp.vec3(*masses)
        leg.c1, leg.c2, leg.c3 = (wp.vec3(*centre) for centre in centres)
        leg.i1, leg.i2, leg.i3 = (wp.mat33(*inertia.ravel()) for inertia in inertias)
        leg.offset = wp.vec3(0.0, SIDE[number] * ABDUCTION, 0.0)
        legs.append(leg)
    return wp.array(legs, dtype=leg_kernel.Leg, device="cpu")
