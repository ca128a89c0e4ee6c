"""Motion without physics: bases that walk, trot, bound,
or are carried by hand, over the ground, with their feet.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from saltus.heightmap.scan.training.ground_patches import GroundPatches, nearest_heights
from saltus.heightmap.scan.training.pose_tables import STEP_S, rotation_of_angles
from saltus.heightmap.scan.training.seeded_random import SeededRandom
from saltus.heightmap.scan.training.settings import GAITS, FlightSettings

FEET = 4
_PHASES = ((0.0, 0.5, 0.75, 0.25), (0.0, 0.5, 0.5, 0.0), (0.0, 0.0, 0.5, 0.5), (0.0, 0.0, 0.0, 0.0))
"""When the stance of each foot (front left, front right, hind left, hind right) begins, by gait;
of a cycle."""
_DUTY = (0.7, 0.5, 0.35, 0.0)
"""How much of a cycle a foot stands."""
_FOOT_REACH_M = 0.12
"""A foot stands on what is not farther than this from where the legs usually are [m]."""


class FlightMotion(NamedTuple):
    """True motion of the robots of a flight: tables of steps of `STEP_S`, in the world."""

    position: Tensor
    """Place of the base [m], shape (robots, steps, 3)."""
    angles: Tensor
    """Roll, pitch, yaw [rad], shape (robots, steps, 3)."""
    feet: Tensor
    """Undersides of the feet while they stand [m], shape (robots, steps, 4, 3)."""
    standing: Tensor
    """Which feet stand, shape (robots, steps, 4)."""
    body_height: Tensor
    """Height of the base above the ground where it stands [m], shape (robots,)."""
    gait: Tensor
    """Place in `GAITS`, shape (robots,)."""


def draw_motion(
    ground: GroundPatches,
    body_height: Tensor,
    duration_s: Tensor,
    settings: FlightSettings,
    draws: SeededRandom,
) -> FlightMotion:
    """Motion over the ground; the way of the first `duration_s` lies around the patch's middle.

    Both (robots,).
    """
    n = len(body_height)
    steps = math.ceil((settings.images / settings.rate_hz[0] + settings.latency_s[1]) / STEP_S) + 2
    time = torch.arange(steps, device=draws.device) * STEP_S
    kinds = torch.tensor([GAITS.index(name) for name in settings.gaits], device=draws.device)
    gait = kinds[draws.number(len(kinds), n)]
    frequency = draws.uniform(1.6, 3.2, n)
    phase = draws.uniform(0.0, 1.0, n)[:, None] + frequency[:, None] * time
    sway, angles = _sway(gait, phase, time, settings, draws)
    xy = _way(gait, angles[..., 2], duration_s, settings, draws)
    support = _support(ground, xy, angles[..., 2], body_height, settings)
    z = support + body_height[:, None] + sway[..., 2]
    position = torch.cat((xy + sway[..., :2], z[..., None]), -1)
    feet, standing = _feet(
        ground, position, angles, phase, frequency, gait, body_height, support, settings
    )
    return FlightMotion(position, angles, feet, standing, body_height, gait)


def _sway(
    gait: Tensor, phase: Tensor, time: Tensor, settings: FlightSettings, draws: SeededRandom
) -> tuple[Tensor, Tensor]:
    """Displacement of the base [m] and its angles [rad] over the time,
    each of shape (robots, steps, 3).
    """
    n, degree = len(gait), math.pi / 180.0
    is_hand, is_bound = (gait == GAITS.index(name) for name in ("hand", "bound"))
    cycle = 2.0 * math.pi * phase

    def wave(usual: float, bound: Tensor | float, harmonic: int) -> Tensor:
        size = draws.uniform(0.3, 1.0, n) * torch.where(is_bound, bound, usual) * ~is_hand
        return size[:, None] * (harmonic * cycle + draws.uniform(0.0, 6.3, n)[:, None]).sin()

    def carried(size: float) -> Tensor:
        waves = [
            (
                2.0 * math.pi * draws.log_uniform(0.2, 2.5, n)[:, None] * time
                + draws.uniform(0.0, 6.3, n)[:, None]
            ).sin()
            for _ in range(3)
        ]
        return (draws.uniform(0.2, 1.0, n) * is_hand * size)[:, None] * sum(waves[1:], waves[0])

    pitch = draws.uniform(settings.pitch_deg[0], settings.pitch_deg[1], n) * degree
    arc = draws.uniform(0.02, 0.12, n)
    bounce = wave(0.02, 0.0, 2) + torch.where(is_bound, arc, 0.0)[:, None] * cycle.sin()
    roll = wave(3.0 * degree, 4.0 * degree, 1) + carried(5.0 * degree)
    tilt = wave(4.0 * degree, 0.0, 2) + carried(8.0 * degree)
    tilt = tilt + torch.where(is_bound, pitch, 0.0)[:, None] * (
        cycle.cos() + draws.uniform(0.0, 0.3, n)[:, None] * (2.0 * cycle).sin()
    )
    lean = draws.normal(2.0 * degree, n, 2)[:, None, :].expand(n, len(time), 2)
    rate = torch.where(draws.chance(0.25, n), draws.uniform(-1.5, 1.5, n), draws.normal(0.25, n))
    yaw = (
        draws.uniform(-math.pi, math.pi, n)[:, None]
        + rate[:, None] * time
        + wave(2.0 * degree, 2.0 * degree, 1)
    )
    angles = torch.stack(
        (roll + lean[..., 0], tilt + lean[..., 1], yaw + carried(10.0 * degree)), -1
    )
    sway = torch.stack(
        (carried(0.03), carried(0.03) + wave(0.015, 0.01, 1), bounce + carried(0.04)), -1
    )
    return sway, angles


def _way(
    gait: Tensor, yaw: Tensor, duration_s: Tensor, settings: FlightSettings, draws: SeededRandom
) -> Tensor:
    """Where the base goes [m], shape (robots, steps, 2); its middle is near the patch's."""
    n, steps = yaw.shape
    fastest = torch.where(gait == GAITS.index("bound"), 1.0, 0.7) * settings.speed_mps
    speed = draws.uniform(0.0, 1.0, n).sqrt() * fastest * ~draws.chance(0.08, n)
    slip = torch.where(
        draws.chance(0.2, n), draws.uniform(-math.pi, math.pi, n), draws.normal(0.1, n)
    )
    heading = yaw + slip[:, None]
    time = torch.arange(steps, device=yaw.device) * STEP_S
    change = (
        1.0
        + 0.3
        * (draws.uniform(0.5, 3.0, n)[:, None] * time + draws.uniform(0.0, 6.3, n)[:, None]).sin()
    )
    velocity = (speed[:, None] * change)[..., None] * torch.stack(
        (heading.cos(), heading.sin()), -1
    )
    way = velocity.cumsum(1) * STEP_S
    middle = (0.5 * duration_s / STEP_S).long().clamp(max=steps - 1)
    return (
        way
        - way[torch.arange(n, device=yaw.device), middle][:, None]
        + draws.uniform(-0.4, 0.4, n, 1, 2)
    )


def _support(
    ground: GroundPatches, xy: Tensor, yaw: Tensor, body_height: Tensor, settings: FlightSettings
) -> Tensor:
    """Height that the base rides on [m], shape (robots, steps):
    what is under it, ahead of time and smoothed.
    """
    reach = (0.7 * body_height).clamp(0.15, 0.35)[:, None]
    cos, sin = yaw.cos() * reach, yaw.sin() * reach
    places = [(0.0, 0.0), (1.0, 0.6), (1.0, -0.6), (-1.0, 0.6), (-1.0, -0.6)]
    under = torch.stack(
        [
            nearest_heights(
                ground.height,
                xy[..., 0] + cos * a - sin * b,
                xy[..., 1] + sin * a + cos * b,
                settings.raster_m,
            )
            for a, b in places
        ]
    ).amax(0)
    under = torch.maximum(under, ground.floor[:, None])
    raised = functional.max_pool1d(
        functional.pad(under[:, None], (15, 15), mode="replicate"), 31, 1
    )
    return functional.avg_pool1d(functional.pad(raised, (20, 20), mode="replicate"), 41, 1)[:, 0]


def _feet(
    ground: GroundPatches, position: Tensor, angles: Tensor, phase: Tensor, frequency: Tensor,
    gait: Tensor,
    body_height: Tensor, support: Tensor, settings: FlightSettings,
) -> tuple[Tensor, Tensor]:  # fmt: skip
    """Places where feet stand [m], and which do: each stays
    where the hip is in the middle of its stance.
    """
    n, steps = phase.shape
    offsets, duty = (torch.tensor(values, device=phase.device)[gait] for values in (_PHASES, _DUTY))
    turn = (phase[..., None] + offsets[:, None, :]) % 1.0
    steps_off = (turn - 0.5 * duty[:, None, None]) / frequency[:, None, None] / STEP_S
    place = (
        (torch.arange(steps, device=phase.device)[None, :, None] - steps_off)
        .round()
        .long()
        .clamp(0, steps - 1)
    )
    robots = torch.arange(n, device=phase.device)[:, None, None]
    middle, yaw = position[robots, place][..., :2], angles[robots, place][..., 2]
    length, width = (
        size * (body_height / 0.28).clamp(0.7, 2.0)[:, None, None] for size in (0.19, 0.13)
    )
    hips = torch.tensor(((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)), device=phase.device)
    a, b = length * hips[:, 0], width * hips[:, 1]
    x = middle[..., 0] + yaw.cos() * a - yaw.sin() * b
    y = middle[..., 1] + yaw.sin() * a + yaw.cos() * b
    z = nearest_heights(ground.height, x, y, settings.raster_m)
    standing = (turn < duty[:, None, None]) & (
        (z - support[..., None]).abs() < _FOOT_REACH_M + 0.2 * length
    )
    return torch.stack((x, y, z), -1), standing


def in_base(points: Tensor, position: Tensor, angles: Tensor) -> Tensor:
    """Points (robots, n, 3) of the world in the frame of a base
    at (robots, 3) with angles (robots, 3).
    """
    return (points - position[:, None]) @ rotation_of_angles(angles)
