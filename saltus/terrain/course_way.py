"""A way over ground in two dimensions, along which segments
of a course lay their boxes one behind the other.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from saltus.terrain.boxes import Box, Boxes
from saltus.terrain.terrain import THICKNESS

SLAB_M = 0.3
"""Thickness of a slope: nothing falls through it, and it does not reach far below the ground beside
it."""


@dataclass
class CourseWay:
    """Where the next segment begins, and what was laid so far.

    Lengths in metres, angles in radians.

    A segment speaks of places ahead of where it begins, aside to the left, and up.
    """

    width: float
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    """Height of the ground there."""
    yaw: float = 0.0
    """Where it leads."""
    blocks: list[tuple[Box, bool]] = field(default_factory=list)
    """Boxes, and whether each goes on down to the floor of the course."""

    def go(self, ahead: float, up: float = 0.0) -> None:
        """The next segment begins this much further ahead, and higher."""
        self.x, self.y = self.place(ahead, 0.0)
        self.z += up

    def place(self, ahead: float, aside: float) -> tuple[float, float]:
        """World x and y of a place."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return self.x + cos * ahead - sin * aside, self.y + sin * ahead + cos * aside

    def block(
        self,
        ahead: tuple[float, float],
        up: float,
        aside: tuple[float, float] | None = None,
        thick: float | None = None,
    ) -> None:
        """A level block from one place ahead to another, `up` above the ground, as wide as the way.

        It is solid down to the floor, unless it is a plate, `thick`.
        """
        right, left = aside or (-0.5 * self.width, 0.5 * self.width)
        middle, size = (
            (0.5 * (ahead[0] + ahead[1]), 0.5 * (right + left)),
            (ahead[1] - ahead[0], left - right),
        )
        self.thing(middle, size, up, thick or THICKNESS, to_floor=thick is None)

    def thing(
        self,
        middle: tuple[float, float],
        size: tuple[float, float],
        top: float,
        thick: float,
        *,
        yaw: float = 0.0,
        pitch: float = 0.0,
        to_floor: bool = False,
    ) -> None:
        """A box whose upper face has its middle at a place ahead and aside, `top` above the ground.

        Turned there.
        """
        x, y = self.place(*middle)
        turn = math.remainder(self.yaw + yaw, 2.0 * math.pi)
        # The centre lies half the thickness below, along the box's own z
        sin, cos = (
            math.sin(pitch),
            math.cos(pitch),
        )
        center = (
            x - 0.5 * thick * sin * math.cos(turn),
            y - 0.5 * thick * sin * math.sin(turn),
            self.z + top - 0.5 * thick * cos,
        )
        self.blocks.append((Box.at(center, (*size, thick), pitch=pitch, yaw=turn), to_floor))

    def slope(self, length: float, up: float) -> None:
        """A slope whose upper face leads from here to a place `length` ahead and `up`."""
        self.thing(
            (0.5 * length, 0.0),
            (math.hypot(length, up), self.width),
            0.5 * up,
            SLAB_M,
            pitch=-math.atan2(up, length),
        )

    def boxes(self, floor_m: float, margin_m: float) -> tuple[Box, ...]:
        """All of them on a floor `floor_m` below the lowest upper face
        that reaches `margin_m` beyond.
        """
        arrays = Boxes.of([box for box, _ in self.blocks])
        low = np.asarray(arrays.center - arrays.extent).min(axis=0) - margin_m
        high = np.asarray(arrays.center + arrays.extent).max(axis=0) + margin_m
        floor = min(0.0, *(box.high[2] for box, to_floor in self.blocks if to_floor)) - floor_m
        bottom = floor - THICKNESS
        ground = Box(
            low=(float(low[0]), float(low[1]), bottom), high=(float(high[0]), float(high[1]), floor)
        )
        return (
            ground,
            *(_down_to(box, bottom) if to_floor else box for box, to_floor in self.blocks),
        )


def _down_to(box: Box, bottom: float) -> Box:
    """A level box made solid down to a height [m]."""
    (x0, y0, _), (x1, y1, top) = box.low, box.high
    return Box(low=(x0, y0, bottom), high=(x1, y1, top), pitch=box.pitch, yaw=box.yaw)
