"""A bracket that holds a D435i where a robot has its camera, to be printed.

A base plate lies on the trunk, fastened by straps or screws through its slots. A back plate, tilted
by the camera's pitch, has slots for the two screws in the camera's back. Two webs join them. All
sizes follow from the robot's camera pose and trunk, in millimetres in its base frame.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh

from saltus.arrays import Floats
from saltus.errors import ConfigError
from saltus.robots.robot import Robot

MM = 1e3
# A D435i (Intel's data sheet of the D400 series): 90 x 25 x 25 mm; depth is measured from the left
# imager, 17.5 mm beside the middle and 4.2 mm behind the glass; two M3 threads in its back, 45 mm
# apart at half its height
CAMERA_MM = (25.0, 90.0, 25.0)
"""Depth, width and height of the camera."""
IMAGER_ASIDE_MM, IMAGER_BEHIND_MM = 17.5, 4.2
SCREWS_APART_MM = 45.0
# Choices, for a printed plastic with four perimeters
PLATE_MM, WEB_MM = 4.0, 5.0
BASE_MM, BACK_MM = (60.0, 90.0), (60.0, 25.0)
"""Length and width of the base plate, width and height of the back plate."""
SCREW_SLOT_MM = (8.0, 3.4)
"""Across and up: an M3 screw moves by 4.6 mm sideways."""
STRAP_SLOT_MM, STRAPS_APART_MM = (25.0, 4.5), 70.0
"""Slots along the trunk, for a strap of 20 mm or M4 screws."""
WEBS_APART_MM = 24.0
"""Between the screws, which stay in reach."""
STEEPEST = np.deg2rad(75.0)
LEAST_MM = 5.0
"""Room between the base plate and the lower edge of the back plate."""


@dataclass(frozen=True, kw_only=True)
class Bracket:
    """A bracket that holds a D435i on one robot, with its dimensions.

    Raises:
        ConfigError: the camera sits where a bracket on the trunk cannot hold it.
    """

    robot: Robot

    def __post_init__(self) -> None:
        robot = self.robot
        if robot.camera_roll or robot.camera_yaw or not 0.0 <= robot.camera_pitch <= STEEPEST:
            raise ConfigError(
                "the bracket is for a camera that looks ahead and 0 to 75 degrees down, without "
                "roll and yaw"
            )
        room = self.back[2] - 0.5 * BACK_MM[1] * np.cos(robot.camera_pitch) - self.top - PLATE_MM
        if room < LEAST_MM:
            raise ConfigError(
                f"camera_position leaves {room:.0f} mm between trunk and camera: the bracket needs "
                f"{LEAST_MM:g} mm; put the camera higher"
            )

    @property
    def top(self) -> float:
        """Height of the trunk's top [mm]."""
        return MM * float(self.robot.trunk_center[2] + 0.5 * self.robot.trunk_size[2])

    @property
    def front(self) -> float:
        """Place of the trunk's front [mm]."""
        return MM * float(self.robot.trunk_center[0] + 0.5 * self.robot.trunk_size[0])

    @property
    def axes(self) -> Floats:
        """Columns: the camera's forward, left and up in the base frame, shape (3, 3)."""
        sin, cos = np.sin(self.robot.camera_pitch), np.cos(self.robot.camera_pitch)
        return np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])

    @cached_property
    def back(self) -> Floats:
        """Middle of the camera's back [mm], shape (3,)."""
        to_middle = np.array([IMAGER_BEHIND_MM - CAMERA_MM[0], -IMAGER_ASIDE_MM, 0.0])
        return MM * self.robot.camera_position + self.axes @ to_middle

    @property
    def end(self) -> float:
        """Front end of the base plate [mm]: that of the trunk,
        but behind the plane of the camera's back.
        """
        behind = self.back[0] + (self.top - self.back[2]) * np.tan(self.robot.camera_pitch)
        return min(self.front, float(behind))

    def mesh(self) -> trimesh.Trimesh:
        """Four closed bodies that overlap: slicers join them."""
        webs = [self._web(side) for side in (-0.5, 0.5)]
        mesh: trimesh.Trimesh = trimesh.util.concatenate([self._base(), self._back(), *webs])
        return mesh

    def _base(self) -> trimesh.Trimesh:
        (length, width), aside = BASE_MM, 0.5 * STRAPS_APART_MM
        slots = [(0.5 * length, 0.5 * width + side, *STRAP_SLOT_MM) for side in (-aside, aside)]
        plate = slotted(length, width, slots)
        corner = (self.end - length, self.back[1] - 0.5 * width, self.top)
        plate.apply_translation(corner)
        return plate

    def _back(self) -> trimesh.Trimesh:
        (width, height), aside = BACK_MM, 0.5 * SCREWS_APART_MM
        slots = [(0.5 * width + side, 0.5 * height, *SCREW_SLOT_MM) for side in (-aside, aside)]
        plate = slotted(width, height, slots)
        plate.apply_translation((-0.5 * width, -0.5 * height, 0.0))
        forward, left, up = self.axes.T
        place = np.eye(4)
        place[:3, :3] = np.stack([-left, up, -forward], axis=1)  # its thickness goes backwards
        place[:3, 3] = self.back
        plate.apply_transform(place)
        return plate

    def _web(self, side: float) -> trimesh.Trimesh:
        """One web: the hull of a strip of the base plate and one of the back plate."""
        forward, _, up = self.axes.T
        y = self.back[1] + side * WEBS_APART_MM
        half = 0.5 * BACK_MM[1]
        corners = [
            self.back + depth * forward + height * up
            for depth in (0.0, -PLATE_MM)
            for height in (-half, half)
        ]
        corners += [
            np.array([self.end - back, 0.0, self.top + height])
            for back in (0.0, 0.6 * BASE_MM[0])
            for height in (0.0, PLATE_MM)
        ]
        points = [
            (x, y + aside, z) for x, _, z in corners for aside in (-0.5 * WEB_MM, 0.5 * WEB_MM)
        ]
        return trimesh.convex.convex_hull(np.array(points))


def slotted(
    length: float, width: float, slots: list[tuple[float, float, float, float]]
) -> trimesh.Trimesh:
    """A closed plate from (0, 0, 0) to (length, width, `PLATE_MM`) with slots right through.

    Args:
        length: Along x [mm].
        width: Along y [mm].
        slots: Middle x and y of each, and its sides along x and y [mm].
    """
    cuts_x = [edge for x, _, side, _ in slots for edge in (x - 0.5 * side, x + 0.5 * side)]
    cuts_y = [edge for _, y, _, side in slots for edge in (y - 0.5 * side, y + 0.5 * side)]
    x, y = np.unique([0.0, length, *cuts_x]), np.unique([0.0, width, *cuts_y])
    middle_x, middle_y = 0.5 * (x[1:] + x[:-1]), 0.5 * (y[1:] + y[:-1])
    full = np.ones((len(middle_x), len(middle_y)), np.bool_)
    for at_x, at_y, side_x, side_y in slots:
        inside_x, inside_y = (
            abs(middle_x - at_x) < 0.5 * side_x,
            abs(middle_y - at_y) < 0.5 * side_y,
        )
        full &= ~(inside_x[:, None] & inside_y)
    padded = np.pad(full, 1)
    quads = []
    for i, j in np.argwhere(full):
        (x0, x1), (y0, y1), z1 = x[i : i + 2], y[j : j + 2], PLATE_MM
        quads.append([(x0, y0, 0.0), (x0, y1, 0.0), (x1, y1, 0.0), (x1, y0, 0.0)])
        quads.append([(x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1)])
        sides = {
            (-1, 0): [(x0, y1), (x0, y0)], (1, 0): [(x1, y0), (x1, y1)],
            (0, -1): [(x0, y0), (x1, y0)], (0, 1): [(x1, y1), (x0, y1)],
        }  # fmt: skip
        for (di, dj), (a, b) in sides.items():
            if not padded[i + 1 + di, j + 1 + dj]:
                quads.append([(*a, 0.0), (*b, 0.0), (*b, z1), (*a, z1)])
    vertices = np.array(quads, np.float64).reshape(-1, 3)
    first = 4 * np.arange(len(quads))[:, None]
    faces = np.concatenate([first + np.array(corners) for corners in ((0, 1, 2), (0, 2, 3))])
    mesh = trimesh.Trimesh(vertices, faces)
    mesh.merge_vertices()
    return mesh
