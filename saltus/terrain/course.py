"""A course in two dimensions: a list of segments, from a TOML file to a terrain of boxes.

kind = "around a corner"
width = 1.5

[[segments]]
kind = "stairs"
rise = [0.1, 0.2]  # an easy and a hard one: drawn between them, for each layout seed anew
[[segments]]
kind = "turn"
angle = 1.5708
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from saltus.config import TomlValue, check_between, from_table, load_config, read_file, read_toml
from saltus.errors import ConfigError
from saltus.terrain.course_segments import CourseSegment, Level, RandomSizes, segment_of
from saltus.terrain.course_way import CourseWay
from saltus.terrain.terrain import FINISH_AFTER_COURSE, GROUND_START_X, RUN_OUT, STANCE_M, Terrain

FOLDER = Path(__file__).with_name("courses")
"""Courses that Saltus brings."""
AHEAD_RAD = math.radians(60.0)
"""A course that leads on within this of the start's direction ends at a line across it."""


@dataclass(frozen=True, kw_only=True)
class Course(TomlValue):
    """Segments one behind the other, after level ground
    at the start and before level ground at the end.

    Raises:
        ConfigError: it has no segment, or a size that is none.
    """

    kind: str
    segments: tuple[CourseSegment, ...]
    width: float = 2.0
    """Width of the way [m]."""
    floor_m: float = 0.0
    """How far the floor beside the way lies below its lowest place [m]."""
    margin_m: float = 2.0
    """How far that floor reaches beyond the way [m]."""

    def __post_init__(self) -> None:
        check_between(self, width=(0.3, 20.0), floor_m=(0.0, 10.0), margin_m=(0.0, 20.0))
        if not self.segments:
            raise ConfigError(f"course '{self.kind}' has no segments: it must have at least one")

    @classmethod
    def from_toml(cls, text: str) -> "Course":
        """Reads a file of a course."""
        table = read_toml(text)
        listed = table.pop("segments", [])
        if not isinstance(listed, list):
            raise ConfigError(f"'segments' must be a list of tables, not {listed!r}")
        segments = tuple(segment_of(each, f"segments[{i}]") for i, each in enumerate(listed))
        return cls(segments=segments, **vars(from_table(_Rest, table)))

    def terrain(self, draws: RandomSizes) -> Terrain:
        """The course with its sizes drawn.

        It ends at a line across x, or at its far end in x where it leads away.
        """
        way, _ = self._laid(draws)
        end, leads_ahead = way.x + FINISH_AFTER_COURSE * math.cos(way.yaw), abs(way.yaw) < AHEAD_RAD
        Level(length=RUN_OUT).lay(way, draws)
        boxes = way.boxes(self.floor_m, self.margin_m)
        return Terrain(
            kind=self.kind, boxes=boxes, finish_x=end if leads_ahead else boxes[0].high[0]
        )

    def ends(self, draws: RandomSizes) -> list[tuple[float, float]]:
        """World x and y where each segment ends [m], as `terrain` lays it with equal draws."""
        return self._laid(draws)[1]

    def _laid(self, draws: RandomSizes) -> tuple[CourseWay, list[tuple[float, float]]]:
        way, ends = CourseWay(width=self.width, x=GROUND_START_X), []
        for segment in (Level(length=STANCE_M - GROUND_START_X), *self.segments):
            segment.lay(way, draws)
            ends.append((way.x, way.y))
        return way, ends[1:]


@dataclass(frozen=True, kw_only=True)
class _Rest:
    """Keys that stand beside the segments."""

    kind: str
    width: float = Course.width
    floor_m: float = Course.floor_m
    margin_m: float = Course.margin_m


@dataclass(frozen=True)
class CourseFamily:
    """Courses of a file, whose sizes are drawn."""

    file: Path

    def __call__(self, difficulty: float | None, rng: np.random.Generator) -> Terrain:
        """A course of them; without a difficulty sizes are drawn up to the hard ones.

        `ConfigError` names the file.
        """
        draws = RandomSizes(rng, 1.0 if difficulty is None else difficulty)
        terrain = load_config(Course, self.file).terrain(draws)
        return (
            terrain if difficulty is None else replace(terrain, params={"difficulty": difficulty})
        )


def course_family(name: str) -> CourseFamily | None:
    """The courses of a shipped name, or of a file that has segments in place of boxes;
    None where it is neither.
    """
    shipped = FOLDER / f"{name}.toml"
    if shipped.is_file():
        return CourseFamily(shipped)
    is_file = name.endswith(".toml") and Path(name).is_file()
    return (
        CourseFamily(Path(name))
        if is_file and "segments" in read_file(Path(name), read_toml)
        else None
    )


def shipped_courses() -> list[str]:
    """Names of the courses that Saltus brings."""
    return sorted(file.stem for file in FOLDER.glob("*.toml"))
