"""What effects on body, ground and IMU do to the plant."""

from typing import Any

import numpy as np
import pytest
from samples import ROBOT

from saltus.constants import GRAVITY, PHYSICS_DT
from saltus.effects.body import (
    BaseInertia,
    ComOffset,
    ContactCompliance,
    FootFriction,
    PayloadMass,
    SoftFeet,
)
from saltus.effects.chain import BodyChain, ImuChain
from saltus.effects.effect import Effect
from saltus.effects.imu import ImuBias, ImuLatency
from saltus.joint_command import JointCommand
from saltus.rotations import roll_pitch_yaw, rotation_matrix
from saltus.sim.batch_plant import BatchPlant
from saltus.sim.plant import Plant
from saltus.terrain import flat

BODY: tuple[Effect[Any], ...] = (
    PayloadMass(mass=1.5),
    PayloadMass(mass=-1.0),
    ComOffset(x=0.03, y=-0.02, z=0.01),
    BaseInertia(scale=1.3),
    FootFriction(coefficient=0.4),
    ContactCompliance(time_constant=0.015),
    SoftFeet(torsion=0.02, rolling=0.01, touch=0.1, depth=0.01),
)


def stand(shape: tuple[int, ...] = ()) -> JointCommand:
    full = np.full((*shape, 12), 1.0)
    return JointCommand(
        position=ROBOT.stand_pose * full,
        velocity=0.0 * full,
        kp=100.0 * full,
        kd=2.0 * full,
        torque=0.0 * full,
    )


def settled(*effects: Effect[Any], seconds: float = 1.0) -> Plant:
    plant = Plant(ROBOT, flat.make(), body=BodyChain(effects))
    for _ in range(round(seconds / PHYSICS_DT)):
        plant.step(stand())
    return plant


@pytest.mark.parametrize("effect", BODY, ids=lambda effect: effect.name)
def test_a_batch_takes_body_effects_as_a_single_plant_does(effect: Effect[Any]) -> None:
    chain = BodyChain((effect,))
    single, batch = (
        Plant(ROBOT, flat.make(), body=chain),
        BatchPlant(ROBOT, flat.make(), 2, body=chain, threads=1),
    )
    for _ in range(100):
        alone, together = single.step(stand()), batch.step(stand((2,)))
    np.testing.assert_allclose(together.joint_position[1], alone.joint_position, atol=1e-9)
    np.testing.assert_allclose(
        together.position_base_in_world[0], alone.position_base_in_world, atol=1e-9
    )


@pytest.mark.parametrize("mass", [-1.0, 0.5, 2.0])
def test_feet_carry_the_payload(mass: float) -> None:
    total = settled(PayloadMass(mass=mass)).state.foot_force.sum()
    assert total == pytest.approx((ROBOT.mass + mass) * GRAVITY, rel=0.01)


def test_feet_below_the_centre_of_mass_carry_more() -> None:
    front, left = [0, 1], [1, 3]
    level = settled().state.foot_force
    ahead, aside = (settled(ComOffset(**{axis: 0.02})).state.foot_force for axis in ("x", "y"))
    assert ahead[front].sum() > level[front].sum() + 1.0
    assert aside[left].sum() > level[left].sum() + 1.0


def test_soft_ground_gives_way() -> None:
    claimed, soft = (
        ROBOT.foot_radius - settled(*effects).state.foot_position_in_world[:, 2]
        for effects in ((), (ContactCompliance(time_constant=0.02),))
    )
    assert np.all(soft > 4.0 * claimed)


def test_inertia_turns_the_trunk_alone() -> None:
    claimed, heavy = (
        Plant(ROBOT, flat.make()).model,
        settled(BaseInertia(scale=1.5), seconds=0.0).model,
    )
    np.testing.assert_allclose(heavy.body_inertia[2:], claimed.body_inertia[2:])
    assert np.sum(heavy.body_inertia != claimed.body_inertia) == 3
    assert heavy.body_subtreemass[1] == pytest.approx(claimed.body_subtreemass[1])


@pytest.mark.parametrize("angle", [-0.1, 0.02])
def test_a_level_base_is_reported_at_the_bias(angle: float) -> None:
    plant = Plant(
        ROBOT, flat.make(), imu=ImuChain((ImuBias(roll=angle, pitch=-angle, gyro_z=0.05),))
    )
    roll, pitch, yaw = roll_pitch_yaw(rotation_matrix(plant.imu.quaternion_base_in_world))
    np.testing.assert_allclose([roll, pitch, yaw], [angle, -angle, 0.0], atol=1e-12)
    drift = plant.imu.angular_velocity_base - plant.state.angular_velocity_base
    np.testing.assert_allclose(drift, [0.0, 0.0, 0.05], atol=1e-12)


@pytest.mark.parametrize("steps", [0, 1, 4])
def test_a_late_imu_reports_the_past(steps: int) -> None:
    plant = Plant(ROBOT, flat.make(), imu=ImuChain((ImuLatency(delay=steps * PHYSICS_DT),)))
    true, reported = [], []
    for _ in range(60):
        state = plant.step(stand())
        true.append(state.angular_velocity_base)
        reported.append(plant.imu.angular_velocity_base)
    np.testing.assert_allclose(reported[steps:], true[: len(true) - steps])


def test_robots_of_a_batch_have_their_own_bodies_and_a_reset_empties_their_imu() -> None:
    mass = np.array([0.0, 2.0])
    batch = BatchPlant(
        ROBOT,
        flat.make(),
        2,
        body=BodyChain((PayloadMass(mass=mass),)),
        imu=ImuChain((ImuLatency(delay=0.02),)),
        threads=1,
    )
    for _ in range(400):
        state = batch.step(stand((2,)))
    np.testing.assert_allclose(
        state.foot_force.sum(axis=1), (ROBOT.mass + mass) * GRAVITY, rtol=0.02
    )
    batch.reset(np.array([1]))
    np.testing.assert_allclose(
        batch.imu.quaternion_base_in_world[1], batch.state.quaternion_base_in_world[1]
    )
