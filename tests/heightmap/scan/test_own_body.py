"""Points on a robot are known to be, at any joint angles; the ground a hand away from it stays."""

from dataclasses import replace

import numpy as np
import pytest
from samples import ROBOT

from saltus.heightmap.scan.own_body import MARGIN_M, BodyBox, NoBody, RobotBody
from saltus.robots.leg_shapes import LegShapes
from saltus.robots.robot import Robot

TALL = replace(ROBOT, name="tall", thigh_length=0.3, calf_length=0.28, thigh_zero=0.1)
ROBOTS = [ROBOT, TALL]


@pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.name)
@pytest.mark.parametrize("seed", range(3))
def test_points_on_legs_and_trunk_are_on_the_robot(robot: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    joints = robot.stand_pose + rng.uniform(-0.4, 0.4, 12)
    capsules = LegShapes(robot).capsules(joints)
    share = rng.uniform(0.0, 1.0, (50, len(capsules.radius), 1))
    way = rng.normal(size=(50, len(capsules.radius), 3))
    way *= capsules.radius[:, None] / np.linalg.norm(way, axis=-1, keepdims=True)
    on_legs = (capsules.start + share * (capsules.end - capsules.start) + way).reshape(-1, 3)
    on_trunk = robot.trunk_center + rng.uniform(-0.5, 0.5, (50, 3)) * robot.trunk_size
    points = np.concatenate([on_legs, on_trunk]).astype(np.float32)
    assert RobotBody(robot).holds(points, joints).all()
    assert not NoBody().holds(points, joints).any()


@pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.name)
def test_ground_beside_the_robot_stays(robot: Robot) -> None:
    capsules = LegShapes(robot).capsules(robot.stand_pose)
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (4000, 3)) * [1.0, 0.7, 0.0] - [
        0.0,
        0.0,
        robot.stand_height,
    ]
    along = capsules.end - capsules.start
    away = points[:, None] - capsules.start
    share = (np.sum(away * along, -1) / np.maximum(np.sum(along**2, -1), 1e-12)).clip(0.0, 1.0)
    gap = np.linalg.norm(away - share[..., None] * along, axis=-1) - capsules.radius
    far = gap.min(1) > MARGIN_M + 1e-4
    held = RobotBody(robot).holds(points.astype(np.float32), robot.stand_pose)
    assert far.any()
    assert not held[far].any()
    assert held[gap.min(1) < MARGIN_M - 1e-4].all()


def test_a_box_holds_what_is_in_it() -> None:
    points = np.array(
        [[0.29, 0.0, 0.0], [0.31, 0.0, 0.0], [0.0, -0.19, 0.24], [0.0, 0.0, -0.26]], np.float32
    )
    assert BodyBox((0.6, 0.4, 0.5)).holds(points, np.zeros(12)).tolist() == [
        True,
        False,
        True,
        False,
    ]
