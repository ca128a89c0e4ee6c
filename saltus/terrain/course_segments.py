"""Segments of which a course in two dimensions is made:
each lays its boxes where the one before it ends.

A size is a number, or two, an easy and a hard one, between which it is drawn. Lengths are in
metres, angles in radians.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np

from saltus.config import from_table
from saltus.errors import ConfigError, nearest_hint
from saltus.terrain.boxes import MOST_YAW
from saltus.terrain.course_way import CourseWay

SizeOrRange = float | tuple[float, float]
TILT_RAD = (
    0.3  # of rubble, at most: what lies on level ground hardly leans more without rolling off
)
STONE_YAW_RAD = 0.3  # of a stone, to either side
SHRINKS = 0.3  # a stone is up to this share smaller than the others
LARGEST_M, MOST = 50.0, 400


@dataclass(frozen=True)
class RandomSizes:
    """Random sizes, as far as a difficulty lets them go."""

    rng: np.random.Generator
    difficulty: float = 1.0

    def size(self, size: SizeOrRange) -> float:
        """The number; or one between the easy one and, by the difficulty, the hard one."""
        if not isinstance(size, tuple):
            return float(size)
        easy, hard = size
        return float(easy + self.difficulty * (hard - easy) * self.rng.uniform())

    def spread(self, bounds: tuple[float, float]) -> float:
        """Between two sizes, in equal shares of the logarithm."""
        return float(np.exp(self.rng.uniform(*np.log(bounds))))


@dataclass(frozen=True, kw_only=True)
class CourseSegment(ABC):
    """A part of a course.

    Raises:
        ConfigError: a size that is none.
    """

    kind: ClassVar[str]
    signed: ClassVar[tuple[str, ...]] = ("rise", "angle")
    """Sizes that may be negative."""

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            for number in value if isinstance(value, tuple) else (value,):
                if isinstance(number, bool) or not isinstance(number, int | float):
                    continue
                low = -LARGEST_M if f.name in self.signed else 0.0
                if not low <= number <= (MOST if isinstance(number, int) else LARGEST_M):
                    raise ConfigError(f"{self.kind}.{f.name} = {value!r} is out of range")

    @abstractmethod
    def lay(self, way: CourseWay, draws: RandomSizes) -> None:
        """Lays it, and moves the way to its end."""


@dataclass(frozen=True, kw_only=True)
class Level(CourseSegment):
    """Level ground."""

    kind = "level"
    length: SizeOrRange = 1.0

    def lay(self, way: CourseWay, draws: RandomSizes) -> None:
        """Lays it."""
        length = draws.size(self.length)
        way.block((0.0, length), 0.0)
        way.go(length)


@dataclass(frozen=True, kw_only=True)
class Turn(CourseSegment):
    """A landing as long as it is wide, from which the way goes on in another direction.

    To the left positive.
    """

    kind = "turn"
    angle: SizeOrRange = 0.5 * math.pi

    def lay(self, way: CourseWay, draws: RandomSizes) -> None:
        """Lays a square along each of the two ways."""
        half, angle = 0.5 * way.width, draws.size(self.angle)
        way.block((0.0, 2.0 * half), 0.0)
        way.go(half)
        way.yaw = math.remainder(way.yaw + angle, 2.0 * math.pi)
        way.block((-half, half), 0.0)
        way.go(half)

    def __post_init__(self) -> None:
        for angle in self.angle if isinstance(self.angle, tuple) else (self.angle,):
            if abs(angle) > MOST_YAW:
                raise ConfigError(
                    f"turn.angle = {angle:g}: it is in radians, from {-MOST_YAW} to {MOST_YAW}"
                )


@dataclass(frozen=True, kw_only=True)
class Stairs(CourseSegment):
    """Stairs, down where their rise is negative.

    Hollow ones have plates for treads and nothing between them.
    """

    kind = "stairs"
    steps: int = 8
    rise: SizeOrRange = 0.15
    run: SizeOrRange = 0.28
    hollow: bool = False
    plate: float = 0.04
    """Thickness of the treads of hollow stairs."""

    def lay(self, way: CourseWay, draws: RandomSizes) -> None:
        """Lays a tread for each step; all are alike."""
        rise, run = draws.size(self.rise), draws.size(self.run)
        for _ in range(self.steps):
            way.block((0.0, run), rise, thick=self.plate if self.hollow else None)
            way.go(run, rise)


@dataclass(frozen=True, kw_only=True)
class Ramp(CourseSegment):
    """A slope, down where its rise is negative."""

    kind = "ramp"
    length: SizeOrRange = 2.0
    rise: SizeOrRange = 0.4

    def lay(self, way: CourseWay, draws: RandomSizes) -> None:
        """Lays it."""
        length, rise = draws.size(self.length), draws.size(self.rise)
        way.slope(length, rise)
        way.go(length, rise)


@dataclass(frozen=True, kw_only=True)
class Stones(CourseSegment):
    """Stones of a grid over a trench: each moved and turned within its cell,
    of its own size and height. Cells of whole rows fill the length.
    """

    kind = "stones"
    length: SizeOrRange = 3.0
    pitch: SizeOrRange = 0.45
    """Side of a cell; along the way it is stretched or shrunk until rows fill the length."""
    share: SizeOrRange = 0.75
    """Side of the largest stone, by that of its cell."""
    missing: float = 0.1
    """Share of the cells without a stone."""
    uneven: SizeOrRange = 0.03
    """How much higher or lower a stone may be."""
    depth: SizeOrRange = 0.4

    def lay(self, way: CourseWay, draws: RandomSizes) -> None:
        """Lays the floor of the trench, and the stones."""
        length, pitch, share = (
            draws.size(self.length),
            draws.size(self.pitch),
            draws.size(self.share),
        )
        uneven, depth = draws.size(self.uneven), draws.size(self.depth)
        way.block((0.0, length), -depth)
        rows, columns = max(1, round(length / pitch)), max(1, int(way.width / pitch))
        cell = np.array([length / rows, pitch])
        for i, j in np.ndindex(rows, columns):
            side = share * cell * (1.0 - SHRINKS * draws.rng.uniform(size=2))
            moved = (cell - side) * draws.rng.uniform(-0.5, 0.5, 2)
            yaw, top = (
                draws.rng.uniform(-STONE_YAW_RAD, STONE_YAW_RAD),
                draws.rng.uniform(-uneven, uneven),
            )
            if draws.rng.uniform() >= self.missing:
                middle = (
                    (i + 0.5) * cell[0] + moved[0],
                    (j + 0.5 - 0.5 * columns) * pitch + moved[1],
                )
                way.thing(middle, (side[0], side[1]), top, depth + top + uneven, yaw=yaw)
        way.go(length)


@dataclass(frozen=True, kw_only=True)
class Ditch(CourseSegment):
    """A trench across the way."""

    kind = "ditch"
    length: SizeOrRange = 0.4
    depth: SizeOrRange = (0.1, 0.6)

    def lay(self, way: CourseWay, draws: RandomSizes) -> None:
        """Lays its floor."""
        length = draws.size(self.length)
        way.block((0.0, length), -draws.size(self.depth))
        way.go(length)


@dataclass(frozen=True, kw_only=True)
class Hurdles(CourseSegment):
    """Low walls across the way, with level ground before each."""

    kind = "hurdles"
    count: int = 3
    height: SizeOrRange = (0.05, 0.3)
    thickness: SizeOrRange = 0.1
    spacing: SizeOrRange = 1.0

    def lay(self, way: CourseWay, draws: RandomSizes) -> None:
        """Lays one after the other."""
        for _ in range(self.count):
            before, thick = draws.size(self.spacing), draws.size(self.thickness)
            way.block((0.0, before), 0.0)
            way.block((before, before + thick), draws.size(self.height))
            way.go(before + thick)


@dataclass(frozen=True, kw_only=True)
class Walls(CourseSegment):
    """A corridor: level ground with a wall on either side, within the way's width."""

    kind = "walls"
    length: SizeOrRange = 3.0
    height: SizeOrRange = (0.4, 1.2)
    thickness: SizeOrRange = 0.1

    def lay(self, way: CourseWay, draws: RandomSizes) -> None:
        """Lays ground and walls."""
        length, half = draws.size(self.length), 0.5 * way.width
        way.block((0.0, length), 0.0)
        for side in (-1.0, 1.0):
            inner, outer = side * (half - draws.size(self.thickness)), side * half
            way.block(
                (0.0, length), draws.size(self.height), (min(inner, outer), max(inner, outer))
            )
        way.go(length)


@dataclass(frozen=True, kw_only=True)
class Rubble(CourseSegment):
    """Level ground with blocks on it, of any yaw and leaning a little."""

    kind = "rubble"
    length: SizeOrRange = 3.0
    count: int = 40
    side: tuple[float, float] = (0.1, 0.6)
    """Least and greatest side, in equal shares of the logarithm."""
    height: tuple[float, float] = (0.02, 0.2)
    tilt: float = TILT_RAD

    def lay(self, way: CourseWay, draws: RandomSizes) -> None:
        """Lays the ground, and the blocks into it."""
        length = draws.size(self.length)
        way.block((0.0, length), 0.0)
        for _ in range(self.count):
            middle = draws.rng.uniform(0.0, length), draws.rng.uniform(-0.5, 0.5) * way.width
            a, b, top = draws.spread(self.side), draws.spread(self.side), draws.size(self.height)
            yaw, pitch = draws.rng.uniform(0.0, math.pi), draws.rng.uniform(-self.tilt, self.tilt)
            way.thing(
                middle, (a, b), top, top + 0.5 * a * abs(math.sin(pitch)), yaw=yaw, pitch=pitch
            )
        way.go(length)


@dataclass(frozen=True, kw_only=True)
class Clutter(Rubble):
    """Level ground with things on it, small or tall, that stand upright."""

    kind = "clutter"
    side: tuple[float, float] = (0.04, 0.4)
    height: tuple[float, float] = (0.02, 0.4)
    tilt: float = 0.0


SEGMENTS = {
    each.kind: each
    for each in (Level, Turn, Stairs, Ramp, Stones, Ditch, Hurdles, Walls, Rubble, Clutter)
}


def segment_of(table: object, where: str) -> CourseSegment:
    """The segment of a table of a TOML file; `ConfigError` names what is wrong, and where."""
    if not isinstance(table, dict) or table.get("kind") not in SEGMENTS:
        kind = table.get("kind") if isinstance(table, dict) else table
        raise ConfigError(f"'{where}.kind' = {kind!r}: {nearest_hint(str(kind), SEGMENTS)}")
    rest = {name: value for name, value in table.items() if name != "kind"}
    return from_table(SEGMENTS[table["kind"]], rest, f"{where}.")
