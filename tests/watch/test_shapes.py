"""Triangles of robots and terrains: closed, seen from outside,
of the size of what they stand for, and where it is.
"""

from collections import Counter

import numpy as np
import pytest
from random_terrain import random_terrain
from samples import ROBOT

from saltus.config import TerrainConfig
from saltus.robots.legs import LegKinematics
from saltus.robots.loading import load_robot
from saltus.robots.robot import LEGS
from saltus.robots.shipped import shipped_robots
from saltus.rotations import rotation_matrix
from saltus.sim.visual_shapes import (
    RobotShapes,
    box,
    terrain_edges,
    terrain_tops,
    terrain_walls,
    turned,
)
from saltus.terrain.curriculum import FAMILIES, make_terrain
from saltus.terrain.terrain import Terrain

FLAT = make_terrain(TerrainConfig(terrain="flat"))
TERRAINS = [make_terrain(TerrainConfig(terrain=name)) for name in FAMILIES] + [
    random_terrain(s) for s in range(3)
]


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Of what closed surfaces enclose: positive where they are seen from outside."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return float(np.sum(a * np.cross(b, c)) / 6.0)


def check_closed(vertices: np.ndarray, faces: np.ndarray) -> None:
    """Every side of a triangle is that of another one, the other way round."""
    corners = [tuple(np.round(v, 6)) for v in vertices]
    sides: Counter[tuple[tuple[float, ...], tuple[float, ...]]] = Counter()
    for face in faces.tolist():
        for start, end in zip(face, (*face[1:], face[0]), strict=True):
            if corners[start] != corners[end]:  # a pole of a ball is many corners at one place
                sides[corners[start], corners[end]] += 1
    assert all(count == sides[end, start] for (start, end), count in sides.items())


def test_shapes_of_every_body_are_closed_and_seen_from_outside() -> None:
    for name in shipped_robots():
        for parts in RobotShapes(load_robot(name), FLAT).shapes.values():
            for shape in parts:
                check_closed(shape.vertices, shape.faces)
                assert volume(shape.vertices, shape.faces) > 0.0


def test_boxes_and_what_is_turned_have_the_volume_of_what_they_stand_for() -> None:
    half = np.array([0.1, 0.2, 0.3])
    assert volume(*box(half)) == pytest.approx(8.0 * np.prod(half))
    cylinder = np.array([[0.0, -1.0], [1.0, -1.0], [1.0, 1.0], [0.0, 1.0]])
    assert volume(*turned(cylinder)) == pytest.approx(2.0 * np.pi, rel=0.03)  # of 16 sides


@pytest.mark.parametrize("terrain", TERRAINS, ids=lambda terrain: terrain.kind)
def test_tops_and_walls_of_a_terrain_enclose_its_boxes_and_tops_are_its_ground(
    terrain: Terrain,
) -> None:
    boxes = terrain.arrays
    (tops, top_faces), (walls, wall_faces) = terrain_tops(boxes), terrain_walls(boxes)
    vertices = np.concatenate([tops, walls])
    faces = np.concatenate([top_faces, wall_faces + len(tops)])
    check_closed(vertices, faces)
    assert volume(vertices, faces) == pytest.approx(
        float(np.sum(np.prod(2.0 * boxes.half_size, axis=-1)))
    )
    middle = tops.reshape(-1, 4, 3).mean(axis=1)
    highest = terrain.height_at(middle[:, 0], middle[:, 1])
    assert (middle[:, 2] <= highest + 1e-9).all()
    assert np.isclose(middle[:, 2], highest).any()
    ends = terrain_edges(boxes)
    assert ends.shape == (4 * len(terrain.boxes), 2, 3)
    assert {tuple(np.round(v, 9)) for v in ends.reshape(-1, 3)} == {
        tuple(np.round(v, 9)) for v in tops
    }


def test_feet_that_are_drawn_are_where_the_kinematics_has_them() -> None:
    shapes, legs = RobotShapes(ROBOT, FLAT), LegKinematics(ROBOT)
    rng = np.random.default_rng(0)
    for _ in range(20):
        joints = ROBOT.stand_pose + rng.uniform(-0.3, 0.3, 12)
        places: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        for body, offset, turn in zip(
            shapes.shapes, shapes.offsets, shapes.turns(joints), strict=True
        ):
            position, rotation = places.get(shapes.parents[body], (np.zeros(3), np.eye(3)))
            own = np.zeros(3) if body == "trunk" else offset
            places[body] = position + rotation @ own, rotation @ rotation_matrix(turn)
        for leg, foot in zip(LEGS, legs.position(joints), strict=True):
            position, rotation = places[f"{leg}_calf"]
            drawn = (
                position
                + np.concatenate([s.vertices for s in shapes.shapes[f"{leg}_calf"]]) @ rotation.T
            )
            around = drawn[np.linalg.norm(drawn - foot, axis=1) < 1.5 * ROBOT.foot_radius]
            assert np.linalg.norm(around.mean(axis=0) - foot) < ROBOT.foot_radius
