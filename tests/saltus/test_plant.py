import dataclasses

import mujoco
import numpy as np
import pytest
from samples import PROFILE, ROBOT

from saltus.config import TerrainConfig
from saltus.constants import GRAVITY, PHYSICS_DT
from saltus.effects.chain import ActuatorChain
from saltus.errors import SaltusError
from saltus.joint_command import JointCommand
from saltus.rotations import rotation_matrix
from saltus.sim.plant import Plant
from saltus.sim.plant_state import PlantState
from saltus.terrain import flat
from saltus.terrain.curriculum import FAMILIES, make_terrain

ONE = np.ones(12)


def pd(position: np.ndarray = ROBOT.stand_pose, kp: float = 100.0, kd: float = 4.0) -> JointCommand:
    return JointCommand(
        position=position, velocity=0.0 * ONE, kp=kp * ONE, kd=kd * ONE, torque=0.0 * ONE
    )


def random_commands(count: int, seed: int = 0) -> list[JointCommand]:
    rng = np.random.default_rng(seed)
    return [pd(ROBOT.stand_pose + rng.normal(0.0, 0.2, 12), kp=40.0, kd=1.0) for _ in range(count)]


def run(plant: Plant, commands: list[JointCommand]) -> list[PlantState]:
    return [plant.step(command) for command in commands]


def same(first: PlantState, second: PlantState) -> bool:
    names = [f.name for f in dataclasses.fields(PlantState)]
    return all(np.array_equal(getattr(first, name), getattr(second, name)) for name in names)


@pytest.mark.sample(9)
@pytest.mark.parametrize("kind", FAMILIES)
@pytest.mark.parametrize("payload_kg", [0.0, 1.5])
def test_it_stands(kind: str, payload_kg: float) -> None:
    plant = Plant(ROBOT, make_terrain(TerrainConfig(terrain=kind)), payload_kg=payload_kg)
    plant.reset()
    for _ in range(1000):
        state = plant.step(pd())
    weight = (ROBOT.mass + payload_kg) * GRAVITY
    assert state.foot_force.sum() == pytest.approx(weight, rel=0.01)
    sinking = ROBOT.foot_radius - state.foot_position_in_world[:, 2]
    assert np.all((sinking > 0.0) & (sinking < 0.003))
    assert np.linalg.norm(state.velocity_base_in_world) < 0.01
    np.testing.assert_allclose(np.linalg.norm(state.acceleration_base), GRAVITY, rtol=0.02)
    assert not state.trunk_contact


@pytest.mark.parametrize("kind", FAMILIES)
@pytest.mark.parametrize("x", [-0.2, 0.0, 1.3, 1.55, 1.7])
def test_reset_puts_the_feet_just_above_the_ground(kind: str, x: float) -> None:
    terrain = make_terrain(TerrainConfig(terrain=kind))
    state = Plant(ROBOT, terrain).reset(position_x=x, yaw=0.05)
    feet = state.foot_position_in_world
    above = feet[:, 2] - ROBOT.foot_radius - terrain.height_at(feet[:, 0], feet[:, 1])
    assert np.all(above > 0.0)
    assert not state.foot_force.any()
    if kind == "flat":
        assert np.all(above < 0.03)


def test_nothing_is_felt_in_free_fall() -> None:
    plant = Plant(ROBOT, flat.make(), payload_kg=1.0)
    plant.reset(clearance=3.0)
    limp = pd(kp=0.0, kd=0.0)
    start = plant.state.position_base_in_world[2]
    for _ in range(100):
        state = plant.step(limp)
    np.testing.assert_allclose(state.acceleration_base, 0.0, atol=1e-9)
    np.testing.assert_allclose(state.joint_velocity, 0.0, atol=1e-9)
    assert start - state.position_base_in_world[2] == pytest.approx(
        0.5 * GRAVITY * 0.2**2, rel=0.02
    )


def test_energy_is_kept_in_flight_without_torque() -> None:
    plant = Plant(ROBOT, flat.make())
    plant.reset(clearance=8.0)
    model, data = plant.model, plant.data
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4  # the plant's own errs by its first order
    data.qvel[:] = np.random.default_rng(0).normal(0.0, 0.5, 18)
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    mujoco.mj_forward(model, data)
    before = data.energy.sum()
    kinetic = data.energy[1]
    for _ in range(100):
        mujoco.mj_step(model, data)
    assert abs(data.energy.sum() - before) < 1e-6 * kinetic


def test_the_accelerometer_integrates_to_the_velocity() -> None:
    plant = Plant(ROBOT, flat.make())
    plant.reset()
    for command in random_commands(200):
        before = plant.state
        after = plant.step(command)
        specific = rotation_matrix(after.quaternion_base_in_world) @ after.acceleration_base
        change = (specific - [0.0, 0.0, GRAVITY]) * PHYSICS_DT
        np.testing.assert_allclose(
            after.velocity_base_in_world - before.velocity_base_in_world, change, atol=1e-9
        )


def test_reset_starts_over_to_the_bit() -> None:
    plant = Plant(ROBOT, make_terrain(TerrainConfig()), chain=PROFILE.actuator_chain)
    runs = []
    for _ in range(2):
        plant.reset(position_x=0.1, yaw=0.02)
        runs.append(run(plant, random_commands(200)))
    assert all(same(a, b) for a, b in zip(*runs, strict=True))


def test_states_do_not_change_later() -> None:
    plant = Plant(ROBOT, flat.make())
    first = plant.step(pd())
    kept = {f.name: np.copy(getattr(first, f.name)) for f in dataclasses.fields(first)}
    for command in random_commands(20):
        plant.step(command)
    assert all(np.array_equal(kept[name], getattr(first, name)) for name in kept)


@pytest.mark.parametrize("friction", [0.3, 0.6, 1.0])
def test_feet_hold_no_more_than_friction(friction: float) -> None:
    plant = Plant(ROBOT, flat.make(), friction=friction)
    plant.reset()
    wrench = np.zeros(6)
    slipped = False
    for command in random_commands(300):
        plant.step(command)
        for i in range(plant.data.ncon):
            mujoco.mj_contactForce(plant.model, plant.data, i, wrench)
            tangential = np.hypot(wrench[1], wrench[2])
            assert tangential <= friction * wrench[0] + 1e-6
            slipped |= tangential > 0.99 * friction * wrench[0] > 0.0
    assert slipped


def test_a_limp_robot_falls_on_its_trunk() -> None:
    plant = Plant(ROBOT, flat.make())
    plant.reset()
    limp = pd(kp=0.0, kd=0.2)
    assert any(plant.step(limp).trunk_contact for _ in range(1500))


def test_believed_torque_is_that_of_the_drive_and_the_applied_one_is_limited() -> None:
    plant = Plant(ROBOT, flat.make(), chain=PROFILE.actuator_chain)
    ideal = Plant(ROBOT, flat.make(), chain=ActuatorChain())
    for command in random_commands(50):
        before = plant.state
        state = plant.step(command)
        law = (
            command.kp * (command.position - before.joint_position)
            - command.kd * before.joint_velocity
        )
        np.testing.assert_allclose(state.joint_torque, law, atol=1e-9)
        assert np.all(np.abs(plant.data.ctrl) <= np.abs(state.joint_torque) + 1e-12)
        np.testing.assert_array_equal(ideal.step(command).joint_torque, ideal.data.ctrl)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("field", ["position", "velocity", "torque"])
def test_a_command_that_is_not_finite_is_refused(value: float, field: str) -> None:
    plant = Plant(ROBOT, flat.make(), chain=PROFILE.actuator_chain)
    wrong = dataclasses.replace(pd(), **{field: np.where(np.arange(12) == 5, value, 0.0)})
    for _ in range(5):  # a feed-forward torque takes force after 10 ms
        plant.step(pd())
    with np.errstate(invalid="ignore"), pytest.raises(SaltusError, match="not finite"):
        run(plant, [wrong] * 10)
    plant.reset()
    assert np.isfinite(plant.step(pd()).joint_position).all()
