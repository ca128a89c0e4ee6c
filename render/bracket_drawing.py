"""A drawing of a bracket with its dimensions: from the side,
its back plate from behind, its base plate from above.
"""

from collections.abc import Sequence

import numpy as np

from saltus.render.bracket import (
    BACK_MM,
    BASE_MM,
    CAMERA_MM,
    IMAGER_BEHIND_MM,
    MM,
    PLATE_MM,
    SCREW_SLOT_MM,
    SCREWS_APART_MM,
    STRAP_SLOT_MM,
    STRAPS_APART_MM,
    Bracket,
)

PX = 3.0
"""Pixels for each millimetre."""
WIDTH, HEIGHT = 900, 430
DrawingPoint = tuple[float, float]


def bracket_svg(bracket: Bracket) -> str:
    """An SVG; all numbers in it are in millimetres."""
    parts = [
        *_side(bracket, (330.0, 330.0)),
        *_plate(BACK_MM, SCREW_SLOT_MM, (SCREWS_APART_MM, 0.0), (600.0, 80.0), "back plate"),
        *_plate(
            (BASE_MM[1], BASE_MM[0]), STRAP_SLOT_MM[::-1], (STRAPS_APART_MM, 0.0), (600.0, 230.0),
            "base plate",
        ),
    ]  # fmt: skip
    style = (
        "text{font:13px sans-serif}.part{fill:#d8d8d8;stroke:black}.other{fill:none;stroke:grey;"
        "stroke-dasharray:5 4}.cut{fill:white;stroke:black}.size{stroke:#1f77b4}"
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}">'
        f'<style>{style}</style><rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>\n'
        + "\n".join(parts)
        + "\n</svg>\n"
    )


def _side(bracket: Bracket, origin: DrawingPoint) -> list[str]:
    """Side view; the front of the trunk's top lies at `origin` [px]."""
    forward, _, up = bracket.axes.T

    def seen(x: float, z: float) -> DrawingPoint:
        return origin[0] + PX * (x - bracket.front), origin[1] - PX * (z - bracket.top)

    def box(near: float, far: float) -> list[DrawingPoint]:
        """Between two distances behind the camera's back, as high as the camera."""
        half = 0.5 * CAMERA_MM[2]
        corners = [(near, -half), (near, half), (far, half), (far, -half)]
        places = [bracket.back - along * forward + high * up for along, high in corners]
        return [seen(x, z) for x, _, z in places]

    lens = MM * bracket.robot.camera_position
    rear, end = bracket.end - BASE_MM[0], bracket.end
    base = [(rear, 0.0), (end, 0.0), (end, PLATE_MM), (rear, PLATE_MM)]
    at_lens, corner = seen(lens[0], lens[2]), seen(lens[0], bracket.top)
    behind, ahead = seen(rear, bracket.top), seen(end, bracket.top)
    pitch = np.degrees(bracket.robot.camera_pitch)
    x, z = bracket.front, bracket.top
    trunk = [seen(x - 100.0, z), seen(x, z), seen(x, z - 10.0), seen(x - 100.0, z - 10.0)]
    upper, lower, near = (box(0.0, PLATE_MM)[corner] for corner in (2, 1, 0))
    web = [upper, lower, near, seen(end, z), seen(end - 0.6 * BASE_MM[0], z)]
    return [
        _shape(web, "part"),
        _shape([seen(x, bracket.top + z) for x, z in base], "part"),
        _shape(box(0.0, PLATE_MM), "part"),
        _shape(box(0.0, -CAMERA_MM[0]), "other"),
        _shape(trunk, "other"),
        f'<circle cx="{at_lens[0]:.1f}" cy="{at_lens[1]:.1f}" r="4"/>',
        _size(at_lens, corner, f"{lens[2] - bracket.top:.1f}", (35.0, 0.0)),
        _size(origin, corner, f"{lens[0] - bracket.front:.1f}", (0.0, 35.0)),
        _size(behind, ahead, f"{BASE_MM[0]:g}", (0.0, 60.0)),
        _text((30.0, 40.0), f"{bracket.robot.name}, from its right side: "
                            f"camera {pitch:.1f} degrees nose down"),
        _text((30.0, 60.0), f"dot: left imager, {IMAGER_BEHIND_MM:g} behind the glass; plates "
                            f"{PLATE_MM:g} thick"),
        _text((30.0, 80.0), "dashed: camera and trunk; all lengths in mm"),
    ]  # fmt: skip


def _plate(
    sides: Sequence[float], slot: Sequence[float], apart: DrawingPoint, at: DrawingPoint, name: str
) -> list[str]:
    """A plate with two slots; its left upper corner lies at `at` [px]."""
    width, height = (PX * side for side in sides)
    x, y = at
    middle, half = (x + 0.5 * width, y + 0.5 * height), 0.5 * PX * apart[0]
    cuts = [_rectangle((middle[0] + side, middle[1]), slot) for side in (-half, half)]
    left, right = (middle[0] - half, middle[1]), (middle[0] + half, middle[1])
    return [
        _text((x, y - 40.0), name),
        _shape([(x, y), (x + width, y), (x + width, y + height), (x, y + height)], "part"),
        *(_shape(cut, "cut") for cut in cuts),
        _size((x, y), (x + width, y), f"{sides[0]:g}", (0.0, -15.0)),
        _size((x, y), (x, y + height), f"{sides[1]:g}", (-15.0, 0.0)),
        _size(left, right, f"{apart[0]:g}", (0.0, 0.0)),
        _text((x + 100.0, y - 40.0), f"slots {slot[0]:g} x {slot[1]:g}"),
    ]


def _rectangle(middle: DrawingPoint, sides: Sequence[float]) -> list[DrawingPoint]:
    x, y = (0.5 * PX * side for side in sides)
    return [(middle[0] + i * x, middle[1] + j * y) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]


def _shape(points: Sequence[DrawingPoint], kind: str) -> str:
    return f'<polygon class="{kind}" points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in points)}"/>'


def _size(a: DrawingPoint, b: DrawingPoint, text: str, aside: DrawingPoint) -> str:
    """A dimension from one point to another, drawn beside them."""
    (ax, ay), (bx, by) = ((x + aside[0], y + aside[1]) for x, y in (a, b))
    line = f'<line class="size" x1="{ax:.1f}" y1="{ay:.1f}" x2="{bx:.1f}" y2="{by:.1f}"/>'
    return line + _text((0.5 * (ax + bx) + 4.0, 0.5 * (ay + by) - 4.0), text)


def _text(at: DrawingPoint, text: str) -> str:
    return f'<text x="{at[0]:.1f}" y="{at[1]:.1f}">{text}</text>'
