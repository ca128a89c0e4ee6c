"""Shipped robots are what their sources say, and obey the laws of bodies and drives."""

import mujoco
import numpy as np
import pytest

from saltus.constants import GRAVITY
from saltus.effects.motors import TorqueSpeedLimit
from saltus.effects.profile import load_profile
from saltus.effects.signals import DriveTorque
from saltus.joint_command import JointCommand
from saltus.robots.legs import LegKinematics
from saltus.robots.loading import derive_robot, load_robot
from saltus.robots.robot import JOINTS, Robot
from saltus.robots.shipped import REFERENCE, shipped_folder, shipped_robots
from saltus.robots.similarity import Similarity
from saltus.sim.plant import Plant
from saltus.terrain import flat

ONE = np.ones(12)
NOT_MIRRORED = {("go1", "calf")}
"""Their centres of mass lie 1 mm to the left in both legs: so they stand in Unitree's
description."""
NUMBERS = {
    "go1": {
        # Geometry, masses [kg], limits: Unitree's robot description, rotors lumped into the links
        # that carry them
        "hip_anchor": [
            [0.1881, -0.04675, 0.0],
            [0.1881, 0.04675, 0.0],
            [-0.1881, -0.04675, 0.0],
            [-0.1881, 0.04675, 0.0],
        ],
        "side": [-1.0, 1.0, -1.0, 1.0],
        "abduction_offset": [-0.08, 0.08, -0.08, 0.08],
        "thigh_length": 0.213,
        "calf_length": 0.213,
        "foot_radius": 0.02,
        "trunk_size": [0.3762, 0.0935, 0.114],
        "trunk_center": [0.0, 0.0, 0.0],
        "trunk_mass": 5.204,
        "link_mass": 4 * [0.591 + 0.089, 0.92 + 0.089, 0.135862 + 0.06],
        "mass": 5.204 + 4 * (0.591 + 0.089 + (0.92 + 0.089) + (0.135862 + 0.06)),
        "armature": 1.118e-4
        * np.tile([6.33, 6.33, 9.495], 4) ** 2,  # of the rotors, through the reduction
        "reduction": 4 * [6.33, 6.33, 9.495],
        "joint_lower": 4 * [-0.863, -0.686, -2.818],
        "joint_upper": 4 * [0.863, 4.501, -0.888],
        "torque_limit": 4 * [23.7, 23.7, 35.55],
        "speed_limit": 4 * [30.1, 30.1, 20.06],
        # The controller settings of the authors of "Agile Continuous Jumping in Discontinuous
        # Terrains"
        "stand_pose": 4 * [0.0, 0.9, -1.8],
        "stand_height": 0.268,
        "swing_foot_z": [-0.4, 0.1],
        "camera_position": [0.272, 0.0075, 0.092],
        "camera_pitch": 0.52,
    },
    "go2": {
        # Unitree's robot description; masses as MuJoCo's model collection lumps an older version of
        # it
        "hip_anchor": [
            [0.1934, -0.0465, 0.0],
            [0.1934, 0.0465, 0.0],
            [-0.1934, -0.0465, 0.0],
            [-0.1934, 0.0465, 0.0],
        ],
        "side": [-1.0, 1.0, -1.0, 1.0],
        "abduction_offset": [-0.0955, 0.0955, -0.0955, 0.0955],
        "thigh_length": 0.213,
        "calf_length": 0.213,
        "foot_radius": 0.022,
        "trunk_size": [0.3762, 0.0935, 0.114],
        "trunk_mass": 6.921,
        "link_mass": 4 * [0.678, 1.152, 0.241352],
        "mass": 15.206408,
        "armature": 4 * [0.0044797, 0.0044797, 0.0164624],
        "reduction": 4 * [6.33, 6.33, 12.13461],
        "joint_lower": 2 * [-1.0472, -1.5708, -2.7227] + 2 * [-1.0472, -0.5236, -2.7227],
        "joint_upper": 2 * [1.0472, 3.4907, -0.83776] + 2 * [1.0472, 4.5379, -0.83776],
    },
}


@pytest.fixture(scope="module", params=shipped_robots())
def robot(request) -> Robot:
    return load_robot(request.param)


@pytest.fixture(scope="module")
def model(robot) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(shipped_folder(robot.name) / f"{robot.name}.xml"))


def test_its_numbers_are_those_of_its_sources(robot):
    for name, value in NUMBERS[robot.name].items():
        np.testing.assert_allclose(getattr(robot, name), value, rtol=1e-12, err_msg=name)


def test_its_own_model_has_our_joints_in_our_order_turning_our_way(robot, model):
    assert [model.joint(i).name for i in range(1, model.njnt)] == list(JOINTS)
    assert [model.actuator(i).name for i in range(model.nu)] == list(JOINTS)
    np.testing.assert_array_equal(model.jnt_axis[1:], 4 * [[1, 0, 0], [0, 1, 0], [0, 1, 0]])
    np.testing.assert_array_equal(robot.joint_sign, ONE)


def test_legs_are_each_other_in_a_mirror(robot, model):
    mirror = np.diag([1.0, -1.0, 1.0])
    for link in ("hip", "thigh", "calf"):
        for end in "FR":
            right, left = (model.body(f"{end}{side}_{link}").id for side in "RL")
            assert model.body_mass[right] == model.body_mass[left]
            np.testing.assert_allclose(
                model.body_pos[right], mirror @ model.body_pos[left], atol=1e-12
            )
            if (robot.name, link) in NOT_MIRRORED:
                continue
            np.testing.assert_allclose(
                model.body_ipos[right], mirror @ model.body_ipos[left], atol=1e-12
            )
            np.testing.assert_allclose(
                _inertia(model, right), mirror @ _inertia(model, left) @ mirror, atol=1e-9
            )
    for name in ("joint_lower", "joint_upper", "torque_limit", "armature"):
        legs = getattr(robot, name).reshape(2, 2, 3)
        np.testing.assert_array_equal(legs[:, 0], legs[:, 1], err_msg=name)


def test_it_stands_without_drift_as_high_as_it_says(robot):
    plant, gains = Plant(robot, flat.make()), robot.gains
    plant.reset()
    command = JointCommand(
        position=robot.stand_pose,
        velocity=0.0 * ONE,
        kp=gains.stand_kp * ONE,
        kd=gains.stand_kd * ONE,
        torque=0.0 * ONE,
    )
    settled = [plant.step(command) for _ in range(1000)][-1]
    later = [plant.step(command) for _ in range(1000)][-1]
    drift = later.position_base_in_world - settled.position_base_in_world
    assert np.abs(drift).max() < 1e-3
    assert later.position_base_in_world[2] == pytest.approx(robot.stand_height, abs=8e-3)
    assert later.foot_force.sum() == pytest.approx(robot.mass * GRAVITY, rel=0.01)
    assert not later.trunk_contact


def test_feet_reach_the_ground_beneath_the_hips_and_where_they_land(robot):
    legs = LegKinematics(robot)
    feet = np.stack(
        [
            np.sign(robot.hip_anchor[:, 0]) * robot.neutral_foot[0],
            robot.side * robot.neutral_foot[1],
        ],
        -1,
    )
    for shift in (-1.0, 0.0, 1.0):
        landing = np.column_stack(
            [feet + shift * robot.landing_reach, np.full(4, robot.foot_radius - robot.stand_height)]
        )
        angles = legs.inverse(landing)
        np.testing.assert_allclose(legs.position(angles), landing, atol=1e-9)
        assert np.all((angles > robot.joint_lower) & (angles < robot.joint_upper))
    assert np.all((robot.stand_pose > robot.joint_lower) & (robot.stand_pose < robot.joint_upper))


def test_its_drives_give_no_torque_beyond_its_limits_and_none_at_its_speed(robot):
    (limit,) = [
        e.fitted(robot)
        for e in load_profile("shipped", robot).actuator
        if isinstance(e, TorqueSpeedLimit)
    ]
    speeds = np.linspace(0.0, 1.2, 49)[:, None] * robot.speed_limit
    for way in (1.0, -1.0):
        asked = DriveTorque(
            position=0.0 * speeds, velocity=way * speeds, torque=np.full_like(speeds, 1e3) * way
        )
        along = way * limit.apply(asked, 0.0, None)[0].torque
        assert np.all(along <= robot.torque_limit)
        assert np.all(np.diff(along, axis=0) <= 0.0)
        np.testing.assert_array_equal(along[speeds[:, 0] >= robot.speed_limit[0]], 0.0)
        braking = DriveTorque(
            position=0.0 * speeds, velocity=-way * speeds, torque=np.full_like(speeds, 1e3) * way
        )
        held = way * limit.apply(braking, 0.0, None)[0].torque
        assert np.all((held <= robot.torque_limit) & (held >= along))


def test_guesses_for_a_robot_of_the_references_size_are_its_own_numbers():
    reference = load_robot(REFERENCE)
    size = Similarity.of(reference.leg_length, reference.mass)
    derived = derive_robot(str(shipped_folder(REFERENCE) / f"{REFERENCE}.xml")).robot
    np.testing.assert_allclose(derived.inertia, reference.inertia, rtol=0.01)
    for name in ("swing_foot_z", "landing_reach", "foot_force"):
        np.testing.assert_allclose(getattr(size, name), getattr(reference, name), rtol=1e-6)
    assert vars(size.gains) == pytest.approx(vars(reference.gains), rel=1e-6)
    position = size.camera_position(float(reference.hip_anchor[0, 0]))
    np.testing.assert_allclose(position, reference.camera_position, atol=0.008)


def _inertia(model: mujoco.MjModel, body: int) -> np.ndarray:
    """Inertia of a body about its centre of mass, in its own axes [kg m^2]."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
    axes = rotation.reshape(3, 3)
    return axes @ np.diag(model.body_inertia[body]) @ axes.T
