"""A robot from a model that is not ours: found by structure,
simulated as it was, refused in one line.
"""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from robots.odd_robot import odd_mjcf

from saltus.errors import ConfigError, ModelError
from saltus.robots.legs import LegKinematics
from saltus.robots.loading import load_robot
from saltus.robots.mjcf import RobotDerivation, derive_robot
from saltus.robots.robot import LEGS, Robot

THEIRS = {"FR": "fr", "FL": "fl", "RR": "hr", "RL": "hl"}
CRAWL = '<keyframe><key name="home" qpos="0 0 .6 1 0 0 0 0 1 -2 0 1 -2 0 1 -2 0 1 -2"/></keyframe>'
STAND = (
    '<keyframe><key name="stand" qpos="0 0 .6 1 0 0 0 0 .9 1.7 0 .9 1.7 0 .9 1.7 0 .9 '
    '1.7"/></keyframe>'
)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("odd") / "odd.xml"
    path.write_text(odd_mjcf())
    return path


@pytest.fixture(scope="module")
def derivation(path: Path) -> RobotDerivation:
    return derive_robot(path)


@pytest.fixture(scope="module")
def robot(derivation: RobotDerivation) -> Robot:
    return derivation.robot


def _origin(derivation: RobotDerivation, name: str) -> str:
    return " ".join(
        f"{origin.kind} {origin.detail}" for origin in derivation.origins if origin.field == name
    )


def _joint_ids(model: mujoco.MjModel) -> np.ndarray:
    return np.array(
        [model.joint(f"{THEIRS[leg]}.{joint}").id for leg in LEGS for joint in ("hx", "hy", "kn")]
    )


def test_legs_are_found_by_structure(robot):
    np.testing.assert_allclose(robot.hip_anchor[:, 0], [0.28, 0.28, -0.24, -0.24])
    np.testing.assert_allclose(robot.abduction_offset, [-0.11, 0.11, -0.11, 0.11])
    np.testing.assert_allclose(
        [robot.thigh_length, robot.calf_length], [np.hypot(0.025, 0.3), np.hypot(0.004, 0.31)]
    )
    np.testing.assert_array_equal(robot.joint_sign, [1, 1, -1, -1, 1, -1] * 2)
    np.testing.assert_allclose(robot.trunk_size, [0.5, 0.2, 0.14])
    np.testing.assert_allclose(robot.joint_lower[:6], [-0.6, -0.8, -2.7, -0.6, -0.8, -2.7])
    np.testing.assert_allclose(robot.torque_limit[:3], [40.0, 50.0, np.inf])
    assert robot.mass == pytest.approx(14.5 + 4 * 3.15)


def test_feet_and_jacobians_equal_those_of_mujoco(path, robot):
    model = mujoco.MjModel.from_xml_path(str(path))
    data, legs, joints = mujoco.MjData(model), LegKinematics(robot), _joint_ids(model)
    feet = [model.body(f"{THEIRS[leg]}_foot").id for leg in LEGS]
    for angles in np.random.default_rng(0).uniform(-2.0, 2.0, (50, 12)):
        data.qpos[:7] = (0, 0, 0, 1, 0, 0, 0)
        data.qpos[model.jnt_qposadr[joints]] = robot.joint_sign * angles
        mujoco.mj_forward(model, data)
        position, jacobian = legs.position_and_jacobian(angles)
        np.testing.assert_allclose(position, data.xpos[feet], atol=1e-12)
        for leg, foot in enumerate(feet):
            theirs = np.zeros((3, model.nv))
            mujoco.mj_jac(model, data, theirs, None, data.xpos[foot], foot)
            own = slice(3 * leg, 3 * leg + 3)
            columns = theirs[:, model.jnt_dofadr[joints[own]]] * robot.joint_sign[own]
            np.testing.assert_allclose(jacobian[leg], columns, atol=1e-12)


def test_inverse_undoes_forward_kinematics(robot):
    legs = LegKinematics(robot)
    angles = np.random.default_rng(0).uniform(
        np.tile([-0.5, 0.3, -2.2], 4), np.tile([0.5, 1.2, -0.6], 4), (100, 12)
    )
    np.testing.assert_allclose(legs.inverse(legs.position(angles)), angles, atol=1e-9)


def test_its_plain_model_moves_like_its_own(path, robot):
    own, plain = mujoco.MjModel.from_xml_path(str(path)), mujoco.MjModel.from_xml_string(robot.mjcf)
    dofs = [*range(6), *own.jnt_dofadr[_joint_ids(own)]]
    signs = np.array([1.0] * 6 + robot.joint_sign.tolist())
    rng = np.random.default_rng(0)
    for _ in range(5):
        position, velocity = rng.uniform(-1.0, 1.0, (2, 18))
        found = []
        for model, order, sign in ((own, dofs, signs), (plain, list(range(18)), np.ones(18))):
            data, mass = mujoco.MjData(model), np.zeros((18, 18))
            data.qpos[:7] = (0.1, 0.2, 2.0, 0.5, 0.5, 0.5, 0.5)
            data.qpos[7:][np.array(order[6:]) - 6] = (sign * position)[6:]
            data.qvel[order] = sign * velocity
            mujoco.mj_forward(model, data)
            mujoco.mj_fullM(model, data, mass)
            found.append(
                (mass[np.ix_(order, order)] * np.outer(sign, sign), sign * data.qfrc_bias[order])
            )
        for theirs, ours in zip(*found, strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-9)


def test_a_plain_model_is_derived_from_itself(tmp_path, robot):
    (tmp_path / "odd.xml").write_text(robot.mjcf)
    again = load_robot(str(tmp_path / "odd.xml"))
    for name in (
        "hip_anchor",
        "abduction_offset",
        "link_mass",
        "armature",
        "stand_pose",
        "inertia",
        "trunk_size",
    ):
        np.testing.assert_allclose(
            getattr(again, name), getattr(robot, name), atol=1e-9, err_msg=name
        )
    ours, theirs = (mujoco.MjModel.from_xml_string(text) for text in (again.mjcf, robot.mjcf))
    for name in (
        "body_pos",
        "body_inertia",
        "body_ipos",
        "geom_size",
        "geom_pos",
        "geom_type",
        "jnt_range",
    ):
        np.testing.assert_allclose(
            getattr(ours, name), getattr(theirs, name), atol=1e-9, err_msg=name
        )


def test_what_is_missing_or_guessed_is_named(derivation):
    assert _origin(derivation, "torque_limit") == "missing of calf: taken as none"
    assert _origin(derivation, "speed_limit") == "missing of hip, thigh, calf: taken as none"
    assert _origin(derivation, "gains").startswith("guessed")
    assert "damping 0 to 0.2" in _origin(derivation, "profile")
    assert "stand for hip, calf: " in _origin(derivation, "mjcf")
    assert (
        _origin(derivation, "joint_sign")
        == "model the model counts FR_calf, FL_hip, FL_calf, RR_calf, RL_hip, RL_calf the other way"
    )


@pytest.mark.parametrize("keyframe", ["", CRAWL, STAND], ids=["none", "no stand", "stand"])
def test_the_stand_pose_comes_from_a_keyframe_or_is_a_crouch(tmp_path, keyframe):
    (tmp_path / "odd.xml").write_text(odd_mjcf(keyframe))
    derivation = derive_robot(tmp_path / "odd.xml")
    robot = derivation.robot
    feet = LegKinematics(robot).position(robot.stand_pose)
    if keyframe == STAND:
        np.testing.assert_allclose(robot.stand_pose, [0, 0.9, -1.7] * 4)
        assert _origin(derivation, "stand_pose") == "model keyframe 'stand'"
    else:
        np.testing.assert_allclose(
            feet[:, :2], robot.hip_anchor[:, :2] + [0, 1] * robot.abduction_offset[:, None]
        )
        assert (
            "keyframe 'home' is none: calf beyond their limits" in _origin(derivation, "stand_pose")
        ) == (keyframe != "")
    # Legs give under the weight
    assert 0.0 < robot.foot_radius - feet[:, 2].mean() - robot.stand_height < 0.03


def test_the_toml_wins(tmp_path, path):
    toml = tmp_path / "robot.toml"
    toml.write_text(
        f'name = "other"\nmjcf = "{path}"\nstand_pose = [0.0, 0.8, -1.6]\ntorque_limit = [30, 30, '
        f"40]\n"
        "camera_pitch = 0.3\nstand_height = 0.5\ntrunk_center = [0.1, 0.0, 0.0]\n[gains]\nstand_kp "
        "= 500.0\n"
    )
    for source in (toml, tmp_path):
        robot = load_robot(str(source))
        assert (robot.name, robot.camera_pitch, robot.stand_height, robot.gains.stand_kp) == (
            "other",
            0.3,
            0.5,
            500.0,
        )
        np.testing.assert_array_equal(robot.stand_pose, [0.0, 0.8, -1.6] * 4)
        np.testing.assert_array_equal(robot.torque_limit, [30.0, 30.0, 40.0] * 4)
        np.testing.assert_array_equal(robot.trunk_center, [0.1, 0.0, 0.0])
    derivation = derive_robot(path, toml)
    assert _origin(derivation, "torque_limit") == "toml "
    assert _origin(derivation, "gains").startswith("toml stand_kp guessed stand_kd")


REFUSED = {
    "no floating base": ("<freejoint/>", "", "add <freejoint/>"),
    "an arm": (
        '<body name="camera" pos="0.3 0 0.1">',
        '<body name="arm" pos="0.3 0 0.1"><joint/>',
        "limb 'arm' has 1 joints",
    ),
    "a ball at the hip": (
        '<joint name="fl.hx" axis="0 0 -1" range="-0.3 0.6"',
        '<joint name="fl.hx" type="ball"',
        "hinge",
    ),
    "knees about x": (
        '"fl.kn" axis="0 -1 0"',
        '"fl.kn" axis="1 0 0"',
        "'fl.kn' turns about .1, 0, 0., not about y",
    ),
    "a thigh above its hip": ('name="fl_upper" pos="0', 'name="fl_upper" pos="0.02', "level"),
    "two legs in one quarter": ('name="fl_hip" pos="0.25', 'name="fl_hip" pos="-0.25', "quarter"),
    "one longer leg": (
        'name="fl_foot" pos="-0.004 0 -0.31"',
        'name="fl_foot" pos="-0.004 0 -0.33"',
        "length of the calf",
    ),
    "not XML": ("<mujoco", "<mujoc", "cannot read the model"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_robot_of_another_kind_is_refused_in_one_line(tmp_path, case):
    old, new, why = REFUSED[case]
    text = odd_mjcf()
    assert old in text
    (tmp_path / "odd.xml").write_text(text.replace(old, new, 1))
    with pytest.raises(ModelError, match=why) as refused:
        load_robot(str(tmp_path / "odd.xml"))
    assert "\n" not in str(refused.value)
    assert "odd.xml" in str(refused.value)


BAD_TOML = {
    "unknown key": ("stand_hight = 0.3", "stand_height"),
    "unknown gain": ("[gains]\nstandkp = 3.0", "stand_kp"),
    "two values": ("stand_pose = [0.0, 0.9]", "give 3"),
    "wrong type": ('stand_height = "low"', "stand_height"),
    "below zero": ("stand_height = -0.3", "more than 0"),
    "no such size": ("trunk_size = [1.0, 2.0]", "3 numbers"),
    "no name": ('name = "a robot"', "cannot name a robot"),
    "limits upside down": ("joint_lower = [3.0, 3.0, 3.0]", "joint_upper"),
}


@pytest.mark.parametrize("case", BAD_TOML)
def test_a_bad_toml_is_refused_in_one_line(tmp_path, path, case):
    text, hint = BAD_TOML[case]
    toml = tmp_path / "robot.toml"
    toml.write_text(f'mjcf = "{path}"\n{text}\n')
    with pytest.raises(ConfigError, match=hint):
        load_robot(str(toml))


def test_an_unknown_robot_is_named_with_the_nearest(tmp_path):
    with pytest.raises(ConfigError, match="go1"):
        load_robot("go")
    (tmp_path / "robot.toml").write_text("")
    with pytest.raises(ConfigError, match="mjcf"):
        load_robot(str(tmp_path))


def test_a_robot_survives_toml(robot):
    again = Robot.from_toml(robot.to_toml())
    assert (again, hash(again)) == (robot, hash(robot))
    for name in ("hip_anchor", "torque_limit", "mjcf", "gains", "camera_position"):
        np.testing.assert_array_equal(getattr(again, name), getattr(robot, name))
    with pytest.raises(ValueError, match="read-only"):
        robot.stand_pose[0] = 1.0


def test_the_fingerprint_sees_what_matters(robot):
    text = robot.to_toml()
    assert Robot.from_toml(text.replace("camera_pitch = 0.52", "camera_pitch = 0.53")) != robot
    assert (
        Robot.from_toml(text.replace("camera_pitch = 0.52", "camera_pitch = 0.5200000000000001"))
        == robot
    )
    assert Robot.from_toml(text.replace("mass='1.2'", "mass='1.3'")) != robot
