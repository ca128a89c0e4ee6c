import mujoco
import numpy as np
import pytest
from samples import KINEMATICS, ROBOT

from saltus.constants import PHYSICS_DT
from saltus.robots.loading import load_robot
from saltus.robots.robot import JOINTS, LEGS
from saltus.sim import robot_model
from saltus.terrain import flat, level

POSES = np.random.default_rng(0).uniform(ROBOT.joint_lower, ROBOT.joint_upper, (20, 12))


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return robot_model.build_spec(ROBOT, flat.make()).compile()


def in_the_air(model: mujoco.MjModel, pose: np.ndarray) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[2] = 5.0
    data.qpos[7:] = pose
    return data


@pytest.mark.parametrize("payload_kg", [0.0, 0.4, 1.5])
def test_mass_is_the_published_one_and_the_payload(payload_kg: float) -> None:
    model = robot_model.build_spec(ROBOT, flat.make(), payload_kg=payload_kg).compile()
    assert model.body_mass.sum() == pytest.approx(ROBOT.mass + payload_kg, abs=1e-9)
    assert pytest.approx(12.743, abs=1e-3) == ROBOT.mass


def test_the_robot_is_ideal(model: mujoco.MjModel) -> None:
    np.testing.assert_allclose(model.dof_armature[6:], ROBOT.armature)
    assert not model.dof_armature[:6].any()
    assert not model.dof_damping.any()
    assert not model.dof_frictionloss.any()
    assert not model.actuator_ctrllimited.any()
    assert not model.actuator_forcelimited.any()
    assert model.opt.timestep == PHYSICS_DT
    assert [model.joint(i).name for i in range(1, 13)] == list(JOINTS)
    assert [model.actuator(i).name for i in range(12)] == list(JOINTS)
    np.testing.assert_allclose(
        model.jnt_range[1:], np.stack([ROBOT.joint_lower, ROBOT.joint_upper], axis=-1)
    )


@pytest.mark.parametrize("pose", POSES)
def test_feet_are_where_the_kinematics_say(model: mujoco.MjModel, pose: np.ndarray) -> None:
    data = in_the_air(model, pose)
    mujoco.mj_kinematics(model, data)
    feet = np.stack([data.geom(f"{leg}_foot").xpos for leg in LEGS])
    np.testing.assert_allclose(feet - data.qpos[:3], KINEMATICS.position(pose), atol=1e-9)


@pytest.mark.parametrize("joint", range(12))
def test_positive_torque_accelerates_a_joint_forward(model: mujoco.MjModel, joint: int) -> None:
    data = in_the_air(model, ROBOT.stand_pose)
    data.ctrl[joint] = 1.0
    mujoco.mj_forward(model, data)
    assert data.qacc[6 + joint] > 0.0
    assert data.qfrc_actuator[6 + joint] == 1.0


@pytest.mark.parametrize("link", [robot_model.TRUNK, *JOINTS])
def test_inertia_tensors_belong_to_real_bodies(model: mujoco.MjModel, link: str) -> None:
    moments = np.sort(model.body(link).inertia)
    assert np.all(moments > 0.0)
    assert moments[2] <= moments[0] + moments[1]


def test_the_legs_mirror_each_other(model: mujoco.MjModel) -> None:
    for part in ("hip", "thigh", "calf"):
        bodies = [model.body(f"{leg}_{part}") for leg in LEGS]
        for right, left in (bodies[:2], bodies[2:]):
            # The calf is one part for both sides
            mirrored = right.ipos if part == "calf" else right.ipos * [1, -1, 1]
            np.testing.assert_allclose(left.ipos, mirrored)
            np.testing.assert_allclose(left.mass, right.mass)
            np.testing.assert_allclose(np.sort(left.inertia), np.sort(right.inertia), rtol=1e-6)
        rear_x = -1 if part == "hip" else 1
        np.testing.assert_allclose(bodies[2].ipos, bodies[0].ipos * [rear_x, 1, 1])


def test_everything_touches_the_terrain_and_nothing_itself(model: mujoco.MjModel) -> None:
    robot = model.geom_group == robot_model.ROBOT_GROUP
    terrain = model.geom_group == robot_model.TERRAIN_GROUP
    touches = (model.geom_contype[:, None] & model.geom_conaffinity[None, :]) != 0
    touches |= touches.T
    assert robot.sum() == 17
    assert touches[np.ix_(robot, terrain)].all()
    assert not touches[np.ix_(robot, robot)].any()


def test_options_reach_the_model(model: mujoco.MjModel) -> None:
    plain = model.body(robot_model.TRUNK).ipos
    shift = np.array([0.02, -0.01, 0.03])
    model = robot_model.build_spec(
        ROBOT,
        level.make("stairs", steps=3, rise_m=0.1, run_m=0.3),
        friction=0.33,
        com_shift=shift,
        columns=9,
    ).compile()
    np.testing.assert_allclose(model.body(robot_model.TRUNK).ipos, plain + shift)
    assert np.all(model.geom_friction[model.geom_group == robot_model.ROBOT_GROUP, 0] == 0.33)
    assert (model.geom_group == robot_model.TERRAIN_GROUP).sum() == 9


@pytest.mark.parametrize("name", ["go1", "go2"])
def test_payload_lies_on_the_trunk(name: str) -> None:
    """Its mass is in the middle of its box, whose bottom touches the top of the trunk's."""
    robot = load_robot(name)
    model = robot_model.build_spec(robot, flat.make(), payload_kg=1.5).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    trunk, payload = model.body(robot_model.TRUNK).id, model.body(robot_model.PAYLOAD).id
    above = (data.xipos[payload] - data.xpos[trunk]) @ data.xmat[trunk].reshape(3, 3)
    x, y, z = robot.trunk_center
    top = z + 0.5 * (robot.trunk_size[2] + robot_model.PAYLOAD_SIZE[2])
    np.testing.assert_allclose(above, [x, y, top], atol=1e-12)
