"""The shipped robot says what the house was built on, to the bit."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

import saltus.robots
from saltus import go1, kinematics
from saltus.robots.legs import LegKinematics
from saltus.robots.loading import derive_robot, load_robot
from saltus.robots.robot import JOINTS
from saltus.robots.similarity import Similarity
from saltus.sim import scene
from saltus.terrain import flat, stairs
from saltus.terrain.stack import TerrainStack
from saltus.terrain.terrain import Terrain

ROBOT = load_robot("go1")
FOLDER = Path(saltus.robots.__file__).parent / "go1"
RNG = np.random.default_rng(0)
NUMBERS = {
    "hip_anchor": go1.HIP_ANCHOR,
    "side": go1.SIDE,
    "abduction_offset": go1.SIDE * go1.ABDUCTION_LENGTH,
    "thigh_length": go1.THIGH_LENGTH,
    "calf_length": go1.CALF_LENGTH,
    "foot_radius": go1.FOOT_RADIUS,
    "trunk_size": go1.TRUNK_SIZE,
    "trunk_center": np.zeros(3),
    "trunk_mass": go1.TRUNK_MASS,
    "link_mass": np.tile([go1.HIP_MASS, go1.THIGH_MASS, go1.CALF_MASS], 4),
    "mass": go1.MASS,
    "armature": go1.ARMATURE,
    "reduction": go1.REDUCTION,
    "joint_lower": go1.JOINT_LOWER,
    "joint_upper": go1.JOINT_UPPER,
    "torque_limit": go1.TORQUE_LIMIT,
    "speed_limit": go1.SPEED_LIMIT,
    "stand_pose": go1.STAND_POSE,
    "stand_height": go1.STAND_HEIGHT,
    "swing_foot_z": go1.SWING_FOOT_Z,
    "camera_position": go1.CAMERA_POSITION,
    "camera_pitch": go1.CAMERA_PITCH,
}


@pytest.mark.parametrize("name", NUMBERS)
def test_its_numbers_are_the_old_ones(name):
    np.testing.assert_array_equal(getattr(ROBOT, name), NUMBERS[name])


def test_feet_are_where_they_were():
    legs = LegKinematics(ROBOT)
    joints, feet = RNG.uniform(-3.0, 3.0, (500, 12)), RNG.uniform(-0.5, 0.5, (500, 4, 3))
    np.testing.assert_array_equal(legs.position(joints), kinematics.foot_position(joints))
    np.testing.assert_array_equal(legs.jacobian(joints), kinematics.foot_jacobian(joints))
    np.testing.assert_array_equal(legs.inverse(feet), kinematics.inverse_kinematics(feet))
    assert legs.positions_of_one(joints[0].tolist()) == kinematics.foot_positions_of_one(joints[0].tolist())
    on_torch = torch.as_tensor(joints, dtype=torch.float32)
    assert torch.equal(legs.position(on_torch), kinematics.foot_position(on_torch))


def test_guesses_for_a_robot_of_its_size_are_its_own_numbers():
    size = Similarity.of(ROBOT.leg_length, ROBOT.mass)
    np.testing.assert_allclose(_derived_inertia(), ROBOT.inertia, rtol=0.01)
    for name in ("swing_foot_z", "landing_reach", "foot_force"):
        np.testing.assert_allclose(getattr(size, name), getattr(ROBOT, name), rtol=1e-6)
    assert vars(size.gains) == pytest.approx(vars(ROBOT.gains), rel=1e-6)
    position = size.camera_position(float(ROBOT.hip_anchor[0, 0]))
    np.testing.assert_allclose(position, ROBOT.camera_position, atol=0.008)


@pytest.mark.parametrize("terrain", [flat.make(), stairs.make(steps=5, rise_m=0.1, run_m=0.3)], ids=["flat", "stairs"])
@pytest.mark.parametrize("loaded", [False, True], ids=["bare", "loaded"])
def test_the_simulated_plant_is_the_old_one_to_the_bit(terrain, loaded):
    how = {"payload_kg": 1.0, "com_shift": (0.01, 0.003, -0.002), "friction": 0.6, "columns": 30} if loaded else {}
    ours, theirs = (build(terrain, **how).compile() for build in (_spec, scene.build_spec))
    for where in (lambda model: model, lambda model: model.opt):
        names = [name for name in dir(where(ours)) if not name.startswith("_")]
        for name in names:
            new, old = getattr(where(ours), name), getattr(where(theirs), name)
            if isinstance(new, np.ndarray | int | float | bytes):
                np.testing.assert_array_equal(new, old, err_msg=name)


def _derived_inertia() -> np.ndarray:
    return derive_robot(str(FOLDER / "go1.xml")).robot.inertia


def _spec(
    terrain: Terrain,
    *,
    friction: float = scene.FRICTION,
    payload_kg: float = 0.0,
    com_shift: tuple[float, ...] = (0.0, 0.0, 0.0),
    columns: int | None = None,
) -> mujoco.MjSpec:
    """What `scene.build_spec` builds, from the robot's own model."""
    spec = mujoco.MjSpec.from_string(ROBOT.mjcf)
    scene._options(spec)
    for geom in spec.geoms:
        geom.contype, geom.conaffinity, geom.condim, geom.priority, geom.group = 0, 1, 3, 1, scene.ROBOT_GROUP
        geom.solref, geom.solimp = scene.CONTACT_SOLREF, scene.CONTACT_SOLIMP
        geom.friction[0] = friction
    for name in JOINTS:
        joint = spec.joint(name)
        joint.solref_friction, joint.solimp_friction = scene.FRICTION_SOLREF, scene.FRICTION_SOLIMP
        spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT).set_to_motor()
    centers, sizes = TerrainStack([terrain]).boxes(columns or len(terrain.column_top))
    for i, (center, size) in enumerate(zip(centers[0], sizes[0], strict=True)):
        scene._add_column(spec, i, center, size)
    payload, trunk = spec.body(scene.PAYLOAD), spec.body(scene.TRUNK)
    payload.pos = (0.0, 0.0, 0.5 * (ROBOT.trunk_size[2] + scene.PAYLOAD_SIZE[2]))
    payload.explicitinertial, payload.mass, payload.inertia = True, payload_kg, scene.payload_inertia(payload_kg)
    trunk.ipos = trunk.ipos + np.asarray(com_shift)
    scene._add_contact_sensors(spec)
    return spec
