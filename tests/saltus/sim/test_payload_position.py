"""A payload weighs where a log says that it sits,
in robots that are simulated and in those that are moved.
"""

import numpy as np
import pytest
from samples import ROBOT

from saltus.constants import GRAVITY, PHYSICS_DT
from saltus.effects.body import claimed_body
from saltus.rotations import rotation_matrix
from saltus.sim.free_robots import FreeRobots
from saltus.sim.measured_robot import MeasuredMotion, MeasuredRobot
from saltus.terrain.boxes import Boxes

ON_NOTHING = Boxes.of([])
TURN = np.array([0.8, 0.4, -0.4, 0.2])
"""A base that leans: level, it would not tell how high a payload sits."""
IN_THE_AIR = np.concatenate([[0.0, 0.0, 5.0], TURN, ROBOT.stand_pose])
STILL = np.zeros(18)


def forces(position: np.ndarray, mass: float, acceleration: np.ndarray = STILL) -> np.ndarray:
    motion = MeasuredMotion(
        position=IN_THE_AIR[None], velocity=STILL[None], acceleration=acceleration[None]
    )
    return MeasuredRobot(ROBOT, ON_NOTHING, position).forces(motion, claimed_body(payload_kg=mass))[
        0
    ]


@pytest.mark.parametrize("seed", range(8))
def test_payload_pulls_at_its_place(seed: int) -> None:
    rng = np.random.default_rng(seed)
    position, mass = rng.uniform(-0.2, 0.2, 3), rng.uniform(0.1, 3.0)
    more = forces(position, mass) - forces(position, 0.0)
    weight = np.array([0.0, 0.0, mass * GRAVITY])
    np.testing.assert_allclose(more[:3], weight, atol=1e-9)
    np.testing.assert_allclose(
        more[3:6], np.cross(position, weight @ rotation_matrix(TURN)), atol=1e-9
    )
    np.testing.assert_allclose(more[6:], 0.0, atol=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_simulated_payload_falls_as_a_moved_one_does(seed: int) -> None:
    """A robot that falls needs no force at its base and no torque that nobody gave."""
    rng = np.random.default_rng(seed)
    position, mass, torque = (
        rng.uniform(-0.2, 0.2, 3),
        rng.uniform(0.1, 3.0),
        rng.normal(0.0, 2.0, 12),
    )
    robots = FreeRobots(ROBOT, 1, ON_NOTHING)
    robots.set_payload_position(position)
    robots.set_bodies(claimed_body((1,), payload_kg=mass))
    robots.derive(np.arange(1))
    robots.place(IN_THE_AIR[None], STILL[None])
    robots.step(torque[None])
    needed = forces(position, mass, robots.qvel[0] / PHYSICS_DT)
    np.testing.assert_allclose(needed, np.concatenate([np.zeros(6), torque]), atol=1e-3)
