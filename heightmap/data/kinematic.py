"""Made-up bounding over any terrain: motion to train on before, and beside, the motion of a planner.

Base and feet follow prescribed curves; the legs follow by inverse kinematics. Nothing here obeys dynamics: it shows
the network every terrain, speed and attitude cheaply, with feet that stand where they say they stand.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from saltus import go1, kinematics
from saltus.config import TerrainConfig, TerrainKind
from saltus.heightmap.data.delivery import TICK_S
from saltus.heightmap.data.rollouts import Trajectory
from saltus.heightmap.service.features import proprioception
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import TRENCH_DEPTH, Terrain
from saltus.wire.messages import Floats

STANCE = 0.4  # share of the cycle that a leg stands (original: swing ratio 0.6)
PHASE = np.array([0.0, 0.0, 0.45, 0.45])  # the hind legs land this much of a cycle after the front legs (original)
TRUSTED = (0.25, 0.75)  # the middle half of a stance
_SLIP_M = 0.01  # a foot further than this from its foothold is not on it: out of reach
_GRID_M = 0.02  # of the smoothed ground that the base follows


@dataclass(frozen=True, kw_only=True)
class KinematicBounding:
    """A source of motion: random terrain, random gait; see `saltus.terrain` for difficulty."""

    ticks: int = 600
    terrains: tuple[TerrainKind, ...] = ("flat", "stairs", "stepping_stones", "step", "gap")

    def trajectories(self, rng: np.random.Generator, count: int) -> Iterator[Trajectory]:
        """Yields `count` trajectories, one robot each."""
        for _ in range(count):
            yield self._trajectory(rng)

    def _trajectory(self, rng: np.random.Generator) -> Trajectory:
        terrain = _terrain(rng, self.terrains)
        gait = _Gait.draw(rng, self.ticks, terrain)
        base = gait.base(rng, terrain)
        foot_in_world, ground = gait.feet(rng, terrain, base)
        quaternion = base.quaternion(np.zeros(3))
        rotation = kinematics.rotation_matrix(quaternion)
        foot_in_base = (foot_in_world - base.position[:, None]) @ rotation
        joints = np.clip(kinematics.inverse_kinematics(foot_in_base), go1.JOINT_LOWER, go1.JOINT_UPPER)
        reached = np.linalg.norm(kinematics.foot_position(joints) - foot_in_base, axis=-1) < _SLIP_M
        return Trajectory(
            terrain=terrain,
            position_base_in_world=base.position,
            quaternion_base_in_world=quaternion,
            joint_position=joints,
            proprioception=_sensed(rng, base, joints, ground, reached & gait.trusted()),
        )


@dataclass(frozen=True, eq=False)
class _Base:
    position: Floats
    """World frame, shape (ticks, 3)."""
    angles: Floats
    """Roll, pitch, yaw [rad], shape (ticks, 3)."""

    def quaternion(self, tilt_error: Floats) -> Floats:
        """Attitude with an error added to roll, pitch and yaw, shape (ticks, 4)."""
        return kinematics.quaternion_from_roll_pitch_yaw(*np.moveaxis(self.angles + tilt_error, -1, 0))


@dataclass(frozen=True, eq=False)
class _Gait:
    """Phase and speed over time."""

    distance: Floats
    """Along the course [m], shape (ticks,)."""
    phase: Floats
    """Of each leg in cycles, stance first, shape (ticks, 4); negative before its first touch-down."""
    moving: Floats
    """0 while it stands at the start, 1 when it bounds, shape (ticks,)."""
    cycle_m: float

    @staticmethod
    def draw(rng: np.random.Generator, ticks: int, terrain: Terrain) -> "_Gait":
        speed, frequency = rng.uniform(0.3, 1.5), rng.uniform(1.2, 3.5)
        start_s = rng.choice([0.0, rng.uniform(0.5, 1.5)])
        time = np.arange(ticks) * TICK_S
        moving = np.clip((time - start_s) / 0.2, 0.0, 1.0)
        wander = 1.0 + 0.2 * np.sin(2.0 * np.pi * (rng.uniform(0.1, 0.4) * time + rng.uniform()))
        begin = rng.uniform(-0.3, 0.3)
        if start_s == 0.0 and terrain.edges_x.size:  # in the midst of the course, else most of the time is run-up
            begin = rng.uniform(0.0, terrain.last_edge_x)
        distance = begin + np.cumsum(speed * wander * moving) * TICK_S
        phase = np.cumsum(frequency * moving)[:, None] * TICK_S - PHASE
        return _Gait(distance, phase, moving, speed / frequency)

    def stance(self) -> Floats:
        """Progress of each leg in its stance, outside [0, 1] in swing, shape (ticks, 4)."""
        return np.where(self.phase < 0.0, 0.5, (self.phase % 1.0) / STANCE)

    def trusted(self) -> NDArray[np.bool_]:
        """Whether each leg is in the middle of its stance, shape (ticks, 4)."""
        progress = self.stance()
        return (progress >= TRUSTED[0]) & (progress <= TRUSTED[1])

    def base(self, rng: np.random.Generator, terrain: Terrain) -> _Base:
        """The base rides on smoothed ground, and bobs and pitches with the gait."""
        yaw = rng.uniform(-0.1, 0.1) + _wander(rng, len(self.phase), 0.02, 1.0)
        x = self.distance
        ground, slope = _smooth_ground(terrain, x)
        cycle = 2.0 * np.pi * (self.phase[:, 0] + rng.uniform())
        bob, swing = rng.uniform(0.0, 0.12), rng.uniform(0.0, 0.35)
        height = go1.STAND_HEIGHT + rng.uniform(-0.03, 0.05) * self.moving + bob * self.moving * np.sin(cycle)
        pitch = -np.arctan(slope) * rng.uniform(0.6, 1.0) + swing * self.moving * np.sin(cycle + rng.uniform(0.0, 6.3))
        y = rng.uniform(-0.3, 0.3) + _wander(rng, len(x), 0.05, 1.0)
        roll = _wander(rng, len(x), 0.03, 0.3) * self.moving
        angles = np.stack([roll, np.clip(pitch, -0.9, 0.9), yaw], -1)
        return _Base(np.stack([x, y, ground + height], -1), angles)

    def feet(self, rng: np.random.Generator, terrain: Terrain, base: _Base) -> tuple[Floats, Floats]:
        """Centres of the feet in the world, shape (ticks, 4, 3), and height of the ground that each last stood on."""
        hip_x = self.distance[:, None] + go1.HIP_ANCHOR[:, 0]
        hip_y = base.position[:, 1, None] + go1.HIP_ANCHOR[:, 1] + go1.SIDE * go1.ABDUCTION_LENGTH
        cycle = np.floor(np.maximum(self.phase, 0.0))
        within = np.where(self.phase < 0.0, 0.5 * STANCE, self.phase % 1.0)
        # The foothold is where the hip is at the middle of the stance.
        here = hip_x - (within - 0.5 * STANCE) * self.cycle_m * self.moving[:, None]
        held = _hold_per_cycle(here, cycle)
        following = held + self.cycle_m
        swing = np.clip((within - STANCE) / (1.0 - STANCE), 0.0, 1.0)
        blend = swing * swing * (3.0 - 2.0 * swing)
        held, following = _foothold(terrain, held), _foothold(terrain, following)
        x = held + blend * (following - held)
        ground, ahead = terrain.height_at(held), terrain.height_at(following)
        lift = rng.uniform(0.03, 0.12) * np.sin(np.pi * swing)
        z = ground + blend * (ahead - ground) + lift + go1.FOOT_RADIUS
        return np.stack([x, hip_y, z], -1), ground


def _terrain(rng: np.random.Generator, kinds: tuple[TerrainKind, ...]) -> Terrain:
    kind = kinds[rng.integers(len(kinds))]
    # Difficulty squared: what a robot can climb at all is in the lower half.
    config = TerrainConfig(terrain=kind, difficulty=float(rng.uniform() ** 1.5))
    if kind == "stairs":
        config = replace(config, run_m=float(rng.uniform(0.2, 0.45)), rise_m=float(rng.uniform(0.03, 0.22)))
    if kind == "stepping_stones":
        config = replace(config, stone_m=float(rng.uniform(0.3, 0.8)))
    return make_terrain(config)


def _smooth_ground(terrain: Terrain, x: Floats) -> tuple[Floats, Floats]:
    """Height and slope of what the base follows: the upper ground, smoothed over half a body length."""
    grid = np.arange(x.min() - 1.0, x.max() + 1.0, _GRID_M)
    top = terrain.height_at(grid)
    if top.min() < 0.0:  # trenches are jumped, not walked into
        top = maximum_filter1d(top, 1 + 2 * int(0.6 / _GRID_M))
    smooth = gaussian_filter1d(top, 0.15 / _GRID_M)
    return np.interp(x, grid, smooth), np.interp(x, grid, np.gradient(smooth, _GRID_M))


def _foothold(terrain: Terrain, x: Floats) -> Floats:
    """The nearest place to `x` that is not in a trench, within a hand's breadth or two."""
    offsets = 0.05 * np.array([0, 1, -1, 2, -2, 3, -3, 4, -4, 5, -5])
    fit = terrain.height_at(x[..., None] + offsets) > -0.5 * TRENCH_DEPTH
    return x + offsets[np.argmax(fit, axis=-1)]


def _hold_per_cycle(value: Floats, cycle: Floats) -> Floats:
    """Keeps, for each leg, the first value of each cycle. Shapes (ticks, 4)."""
    first = np.diff(cycle, axis=0, prepend=cycle[:1] - 1.0) != 0.0
    index = np.where(first, np.arange(len(value))[:, None], 0)
    return np.take_along_axis(value, np.maximum.accumulate(index, axis=0), axis=0)


def _wander(rng: np.random.Generator, ticks: int, size: float, period_s: float) -> Floats:
    """Smooth random curve of standard deviation `size`, shape (ticks,)."""
    width = period_s / TICK_S / 3.0
    smooth = gaussian_filter1d(rng.normal(size=ticks), width, mode="wrap")
    # By the deviation of smoothed noise, not by that of this curve: a short one hardly varies about its own mean.
    return size * math.sqrt(2.0 * math.sqrt(math.pi) * width) * smooth


def _level_stood_on(ground: Floats, trusted: NDArray[np.bool_]) -> Floats:
    """Mean height of the ground under the trusted feet, held while there are none, shape (ticks,)."""
    count = trusted.sum(-1)
    level = np.where(count > 0, (ground * trusted).sum(-1) / np.maximum(count, 1), ground.mean(-1))
    known = np.where(count > 0, np.arange(len(count)), 0)
    return level[np.maximum.accumulate(known)]


def _sensed(
    rng: np.random.Generator, base: _Base, joints: Floats, ground: Floats, trusted: NDArray[np.bool_]
) -> Floats:
    """Proprioception with the errors of an IMU and of a state estimator that knows its feet only."""
    ticks = len(joints)
    velocity = np.gradient(base.position, TICK_S, axis=0)
    velocity += np.stack([_wander(rng, ticks, rng.uniform(0.0, 0.12), 0.3) for _ in range(3)], -1)
    rotation = kinematics.rotation_matrix(base.quaternion(np.zeros(3)))
    turned = np.swapaxes(rotation[:-1], -1, -2) @ rotation[1:]
    rate = np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]], -1) / TICK_S
    height = base.position[:, 2] - _level_stood_on(ground, trusted)
    return proprioception(
        quaternion_base_in_world=base.quaternion(rng.normal(0.0, 0.01, 3)),
        angular_velocity_base=np.concatenate([rate, rate[-1:]]) + rng.normal(0.0, 0.02, (ticks, 3)),
        joint_position=joints + rng.normal(0.0, 0.005, joints.shape),
        velocity_base_in_world=velocity,
        base_height=height + _wander(rng, ticks, rng.uniform(0.0, 0.02), 0.5),
        leg_trusted=trusted,
    )
