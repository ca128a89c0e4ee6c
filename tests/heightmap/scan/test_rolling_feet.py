"""A robot whose round feet roll comes as far as its states and the rolling say."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from saltus import rotations
from saltus.config import TerrainConfig
from saltus.heightmap.service.rolling_feet import MEAN_S, MOST_MPS, RollingFeet
from saltus.robots.loading import load_robot
from saltus.robots.robot import LEGS, Robot
from saltus.robots.shipped import shipped_robots
from saltus.sim import robot_model
from saltus.states import standing_state
from saltus.terrain.curriculum import make_terrain
from saltus.wire.messages import RobotState

STEPS = 400
"""So many that the mean has settled: 20 of its times."""


@pytest.fixture(scope="module", params=shipped_robots())
def robot(request: pytest.FixtureRequest) -> Robot:
    return load_robot(request.param)


def rolling(robot: Robot, rng: np.random.Generator, sole: float) -> tuple[RobotState, np.ndarray]:
    """A state in which one drawn foot, whose centre is `sole` above the ground, rolls and the base
    has any attitude and turn, and the base's velocity.

    MuJoCo says how the shank turns and the foot moves.
    """
    model = robot_model.build_spec(robot, make_terrain(TerrainConfig(terrain="flat"))).compile()
    data, leg = mujoco.MjData(model), int(rng.integers(4))
    attitude = rotations.quaternion_from_roll_pitch_yaw(
        *(np.asarray(a) for a in rng.uniform(-0.6, 0.6, 3))
    )
    data.qpos[3:7] = attitude
    data.qpos[7:19] = robot.stand_pose + rng.uniform(-0.3, 0.3, 12)
    data.qvel[3:18] = rng.uniform(-1.0, 1.0, 15)
    mujoco.mj_forward(model, data)
    moves, geom = np.zeros(6), model.geom(f"{LEGS[leg]}_foot").id
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_GEOM, geom, moves, 0)
    # While the base only turns: what is under the ball's centre at the ground is to rest
    velocity = np.cross(moves[:3], [0.0, 0.0, sole]) - moves[3:]
    state = replace(
        standing_state(robot),
        quaternion_base_in_world=np.asarray(attitude),
        angular_velocity_base=data.qvel[3:6].copy(),
        joint_position=data.qpos[7:19].copy(),
        joint_velocity=data.qvel[6:18].copy(),
        leg_trusted=np.arange(4) == leg,
    )
    return state, velocity


@pytest.mark.parametrize("seed", range(8))
def test_what_is_missing_is_what_a_rolling_foot_adds(robot: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    sole = rng.uniform(0.0, 1.0) * robot.foot_radius if seed % 2 else robot.foot_radius
    state, velocity = rolling(robot, rng, sole)
    off = rng.uniform(-0.6, 0.6, 3) * MOST_MPS
    feet = RollingFeet(robot)
    feet.sole = sole
    told = replace(state, velocity_base_in_world=velocity - off)
    for _ in range(STEPS):
        missing = feet.missing(told)
    np.testing.assert_allclose(missing, [*off[:2], 0.0], atol=1e-6)
    flying = replace(told, leg_trusted=np.zeros(4, np.bool_))
    np.testing.assert_array_equal(feet.missing(flying), missing)


def test_a_foot_that_slips_tells_nothing(robot: Robot) -> None:
    state, velocity = rolling(robot, np.random.default_rng(0), robot.foot_radius)
    slips = replace(state, velocity_base_in_world=velocity + np.array([1.01 * MOST_MPS, 0.0, 0.0]))
    feet = RollingFeet(robot)
    for _ in range(STEPS):
        np.testing.assert_array_equal(feet.missing(slips), 0.0)


def test_one_state_moves_the_mean_by_its_share(robot: Robot) -> None:
    state, velocity = rolling(robot, np.random.default_rng(1), robot.foot_radius)
    off = np.array([0.1, 0.0, 0.0])
    missing = RollingFeet(robot).missing(replace(state, velocity_base_in_world=velocity - off))
    np.testing.assert_allclose(missing, off * 0.01 / MEAN_S, atol=1e-9)


@pytest.mark.parametrize("share", [-0.5, 0.0, 0.3, 0.7, 1.0, 1.5])
def test_feet_that_sink_have_lower_soles(robot: Robot, share: float) -> None:
    """They come to where the ground is, but are neither beyond the foot's centre nor its edge."""
    rng, feet, radius = np.random.default_rng(2), RollingFeet(robot), robot.foot_radius
    for _ in range(STEPS):
        # Each leg's own error cancels out in the mean of four
        errors = rng.normal(0.0, 0.002, 4)
        feet.stand(feet.sole - share * radius + errors - errors.mean())
        feet.stand(np.zeros(0))
        assert 0.0 <= feet.sole <= radius
    np.testing.assert_allclose(feet.sole, np.clip(share, 0.0, 1.0) * radius, atol=1e-4)
