"""Robot and terrain as triangles, for viewers that are no MuJoCo:
shapes of videos, and where they are in a pose.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from saltus.arrays import Floats
from saltus.robots.robot import Robot
from saltus.rotations import quaternion_inverse, quaternion_product
from saltus.sim import robot_model
from saltus.sim.appearance import add_looks
from saltus.terrain import flat
from saltus.terrain.boxes import Boxes
from saltus.terrain.terrain import Terrain

Faces = NDArray[np.int64]

ROUND = 16  # sides of what is round: enough for shapes of a few centimetres
CUBE_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
CUBE_SIDES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4]])
"""Corners of each side but the upper one, counter-clockwise from outside."""
CUBE_TOP = np.array([[1, 5, 7, 3]])


@dataclass(frozen=True, kw_only=True, eq=False)
class VisualShape:
    """Triangles of one colour that move together."""

    vertices: Floats
    """[m], shape (n, 3)."""
    faces: Faces
    """Rows of `vertices`, counter-clockwise from outside, shape (m, 3)."""
    rgba: tuple[float, float, float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Primitive:
    """A box, a ball or a cylinder of a body, for viewers that know such shapes themselves."""

    body: str
    kind: Literal["box", "ball", "cylinder"]
    size: Floats
    """Full extents along its own axes [m], shape (3,); a cylinder stands along z, a ball may be an
    ellipsoid."""
    position: Floats
    """Position of its centre in the frame of the body [m], shape (3,)."""
    quaternion: Floats
    """From its own axes to those of the body (w, x, y, z), shape (4,)."""
    rgba: tuple[float, float, float, float]


class RobotShapes:
    """Shapes of a robot, body by body."""

    def __init__(self, robot: Robot, terrain: Terrain) -> None:
        spec = robot_model.build_spec(robot, terrain)
        add_looks(spec, robot, terrain)
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._seen = np.flatnonzero(
            (self._model.geom_group == robot_model.VISUAL_GROUP) & (self._model.geom_bodyid > 0)
        )
        self._bodies = np.unique(self._model.geom_bodyid[self._seen])
        self._parents = self._model.body_parentid[self._bodies]
        names = [self._model.body(body).name for body in self._bodies]
        self.parents = {
            name: self._model.body(body).name
            for name, body in zip(names, self._parents, strict=True)
        }
        """The body that each hangs on; "world" for the trunk."""
        self.offsets = self._model.body_pos[self._bodies].copy()
        """Where each hangs on it, in its frame [m], shape (n, 3): joints turn bodies about their
        origins."""

    @cached_property
    def shapes(self) -> "dict[str, list[VisualShape]]":
        """Shapes of each body in its own frame, one for each colour; the trunk comes first."""
        return {
            name: self._of_body(body) for name, body in zip(self.parents, self._bodies, strict=True)
        }

    @cached_property
    def primitives(self) -> list[Primitive]:
        """Shapes of the robot that are drawn, as boxes, balls and cylinders;
        a capsule is one cylinder and two balls.
        """
        return [part for geom in self._seen for part in self._primitives_of(int(geom))]

    def turns(self, joint_position: ArrayLike) -> Floats:
        """How each body is turned in the frame of the one that it hangs on (w, x, y, z),
        shape (n, 4).

        The trunk is not turned. Joint positions are in rad, shape (12,).
        """
        self._data.qpos[3:7], self._data.qpos[7:] = (1.0, 0.0, 0.0, 0.0), joint_position
        mujoco.mj_kinematics(self._model, self._data)
        quaternion, parents = self._data.xquat[self._bodies], self._data.xquat[self._parents]
        return quaternion_product(quaternion_inverse(parents), quaternion)

    def _of_body(self, body: int) -> "list[VisualShape]":
        geoms = [int(geom) for geom in self._seen if self._model.geom_bodyid[geom] == body]
        colours = sorted({tuple(self._model.geom_rgba[geom].tolist()) for geom in geoms})
        return [
            _joined(
                [
                    self._triangles(g)
                    for g in geoms
                    if tuple(self._model.geom_rgba[g].tolist()) == rgba
                ],
                rgba,
            )
            for rgba in colours
        ]

    def _primitives_of(self, geom: int) -> list[Primitive]:
        model, kind = self._model, self._model.geom_type[geom]
        size, centre, quaternion = (
            model.geom_size[geom],
            model.geom_pos[geom],
            model.geom_quat[geom],
        )
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, quaternion)

        def part(
            shape: Literal["box", "ball", "cylinder"], half: ArrayLike, along: float = 0.0
        ) -> Primitive:
            return Primitive(
                body=model.body(model.geom_bodyid[geom]).name,
                kind=shape,
                size=2.0 * np.asarray(half, dtype=np.float64),
                position=centre + along * rotation.reshape(3, 3)[:, 2],
                quaternion=np.array(quaternion),
                rgba=tuple(model.geom_rgba[geom].tolist()),
            )

        if kind == mujoco.mjtGeom.mjGEOM_BOX:
            return [part("box", size)]
        if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
            return [part("cylinder", [size[0], size[0], size[1]])]
        if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
            ends = [part("ball", [size[0]] * 3, along) for along in (-size[1], size[1])]
            return [part("cylinder", [size[0], size[0], size[1]]), *ends]
        return [part("ball", size if size[1] > 0.0 else [size[0]] * 3)]

    def _triangles(self, geom: int) -> tuple[Floats, Faces]:
        size, kind = self._model.geom_size[geom], self._model.geom_type[geom]
        if kind == mujoco.mjtGeom.mjGEOM_BOX:
            corners, faces = box(size)
        elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
            corners, faces = turned(
                np.array([[0.0, -1.0], [1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [1.0, 1.0], [0, 1]])
            )
            corners = corners * np.array([size[0], size[0], size[1]])
        elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
            corners, faces = turned(_arc())
            corners = size[0] * corners + np.array([0.0, 0.0, size[1]]) * np.sign(
                np.round(corners[:, 2:], 9)
            )
        else:  # a ball or an ellipsoid
            corners, faces = turned(_arc())
            corners = corners * (size if size[1] > 0.0 else size[0])
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, self._model.geom_quat[geom])
        return corners @ rotation.reshape(3, 3).T + self._model.geom_pos[geom], faces


@lru_cache(maxsize=4)
def looks_of(robot: Robot) -> RobotShapes:
    """Looks of a robot, wherever it stands; kept, as they take 0.1 s."""
    return RobotShapes(robot, flat.make())


def box(half_size: Floats) -> tuple[Floats, Faces]:
    """Triangles of a box about the origin.

    Each side has corners of its own, so that edges look sharp.
    """
    sides = np.concatenate([CUBE_SIDES, CUBE_TOP])
    return _quads(CUBE_CORNERS[sides] * half_size)


def turned(profile: Floats) -> tuple[Floats, Faces]:
    """Triangles of a profile, rows of (radius, z) from below, turned about the z axis."""
    angle = np.linspace(0.0, 2.0 * np.pi, ROUND, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], -1)
    corners = np.concatenate(
        [
            np.concatenate([radius * ring, np.full((ROUND, 1), z)], axis=1)
            for radius, z in profile.tolist()
        ]
    )
    here = np.arange(ROUND)
    there = (here + 1) % ROUND
    faces = []
    for row in range(len(profile) - 1):
        low, high = row * ROUND, (row + 1) * ROUND
        faces.append(np.stack([low + here, low + there, high + there], -1))
        faces.append(np.stack([low + here, high + there, high + here], -1))
    return corners, np.concatenate(faces)


def terrain_tops(boxes: Boxes) -> tuple[Floats, Faces]:
    """Triangles of the upper sides of boxes."""
    return _sides(boxes, CUBE_TOP)


def terrain_walls(boxes: Boxes) -> tuple[Floats, Faces]:
    """Triangles of all other sides."""
    return _sides(boxes, CUBE_SIDES)


def terrain_edges(boxes: Boxes) -> Floats:
    """The edges of the upper sides, shape (4 n, 2, 3)."""
    corners = _in_world(boxes, CUBE_CORNERS[CUBE_TOP[0]])
    return np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 3)


def _sides(boxes: Boxes, sides: NDArray[np.int64]) -> tuple[Floats, Faces]:
    return _quads(_in_world(boxes, CUBE_CORNERS[sides].reshape(-1, 3)).reshape(-1, 4, 3))


def _in_world(boxes: Boxes, corners: Floats) -> Floats:
    """Corners of a cube of half size 1 on every box, shape (n, corners, 3)."""
    local = corners * np.asarray(boxes.half_size)[:, None, :]
    return np.asarray(
        local @ np.swapaxes(np.asarray(boxes.rotation), 1, 2) + np.asarray(boxes.center)[:, None, :]
    )


def _quads(corners: Floats) -> tuple[Floats, Faces]:
    """Two triangles for each row of four corners, shape (n, 4, 3)."""
    first = 4 * np.arange(len(corners))[:, None]
    faces = np.concatenate([first + np.array(triangle) for triangle in ((0, 1, 2), (0, 2, 3))])
    return corners.reshape(-1, 3), faces


def _arc() -> Floats:
    """Half a circle from the lower to the upper pole.

    Twice the equator, where a capsule is pulled apart.
    """
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, ROUND // 2 + 1)
    middle = ROUND // 4
    arc = np.stack([np.cos(angle), np.sin(angle)], -1)
    below, above = arc[middle] - [0.0, 1e-6], arc[middle] + [0.0, 1e-6]
    return np.concatenate([arc[:middle], [below, above], arc[middle + 1 :]])


def _joined(parts: list[tuple[Floats, Faces]], rgba: tuple[float, ...]) -> VisualShape:
    start = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    r, g, b, a = rgba
    return VisualShape(
        vertices=np.concatenate([vertices for vertices, _ in parts]),
        faces=np.concatenate(
            [faces + first for (_, faces), first in zip(parts, start, strict=False)]
        ),
        rgba=(r, g, b, a),
    )
