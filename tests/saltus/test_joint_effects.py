"""What effects of joints and encoders do, alone and to robots."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from samples import ROBOT

from saltus.constants import PHYSICS_DT
from saltus.effects import joint_loads
from saltus.effects.backlash import Backlash
from saltus.effects.body import BaseRoll
from saltus.effects.chain import ActuatorChain, BodyChain
from saltus.effects.effect import Effect
from saltus.effects.encoders import EncoderBias, EncoderQuantisation, VelocityFilter, VelocityScale
from saltus.effects.motors import BatterySag, VoltageSag
from saltus.effects.signals import DriveTorque, EncoderReading, Resistance
from saltus.joint_command import JointCommand
from saltus.rotations import roll_pitch_yaw, rotation_matrix
from saltus.sim.batch_plant import BatchPlant
from saltus.sim.cpu_engine import CpuEngine
from saltus.sim.plant import Plant
from saltus.terrain import flat

ZERO = np.zeros(12)
GROUND = flat.make()
RESISTING: tuple[Effect[Any], ...] = (
    joint_loads.ViscousFriction(coefficient=0.4),
    joint_loads.CoulombFriction(torque=0.5),
    joint_loads.Stiction(breakaway=0.5, stribeck_velocity=0.5),
    joint_loads.Armature(added=0.01),
)
SENSING: tuple[Effect[Any], ...] = (
    EncoderBias(bias=0.03),
    EncoderQuantisation(step=0.01),
    VelocityFilter(time_constant=0.01),
    VelocityScale(scale=1.2),
)
ALL = (
    *RESISTING,
    *SENSING,
    Backlash(width=0.02),
    BatterySag(loss_at_end=0.3, duration_s=1.0),
    VoltageSag(per_kw=0.5),
    joint_loads.JointSpring(torque=0.5, stiffness=2.0),
    joint_loads.EndStop(upper=tuple(ROBOT.stand_pose + 0.1)),
)


def command(position: Any = ROBOT.stand_pose, kp: float = 40.0, kd: float = 1.0) -> JointCommand:
    return JointCommand(
        position=position + ZERO, velocity=ZERO, kp=ZERO + kp, kd=ZERO + kd, torque=ZERO
    )


def swings(effects: tuple[Effect[Any], ...], steps: int = 150) -> tuple[np.ndarray, np.ndarray]:
    """Angles and measured angles of a held robot that is told to swing its legs."""
    plant = Plant(ROBOT, GROUND, chain=ActuatorChain(effects), held=True)
    true, measured = [], []
    for k in range(steps):
        state = plant.step(
            command(ROBOT.stand_pose + 0.2 * np.sin(2.0 * np.pi * 3.0 * k * PHYSICS_DT))
        )
        true.append(plant.data.qpos[7:].copy())
        measured.append(state.joint_position)
    return np.array(true), np.array(measured)


@pytest.mark.parametrize("effect", ALL, ids=lambda effect: effect.name)
def test_robots_move_differently(effect: Effect[Any]) -> None:
    assert np.abs(swings((effect,))[0] - swings(())[0]).max() > 1e-4


@pytest.mark.parametrize("effect", RESISTING[:3], ids=lambda effect: effect.name)
def test_friction_takes_energy(effect: Effect[Any]) -> None:
    """A leg that swings freely comes to rest sooner."""
    energy = []
    for effects in ((), (effect,)):
        plant = Plant(ROBOT, GROUND, chain=ActuatorChain(effects), held=True)
        for _ in range(150):
            state = plant.step(command(kp=0.0, kd=0.0))
        energy.append(float(np.sum(state.joint_velocity**2)))
    assert energy[1] < 0.9 * energy[0]


def test_dry_friction_holds_a_leg() -> None:
    """More friction than gravity asks for: the joints stay where they are."""
    plant = Plant(
        ROBOT, GROUND, chain=ActuatorChain((joint_loads.CoulombFriction(torque=5.0),)), held=True
    )
    for _ in range(200):
        plant.step(command(kp=0.0, kd=0.0))
    np.testing.assert_allclose(plant.data.qpos[7:], ROBOT.stand_pose, atol=1e-3)


@pytest.mark.parametrize("effect", ALL, ids=lambda effect: effect.name)
def test_a_batch_is_its_robots(effect: Effect[Any]) -> None:
    """Robots of a batch do what single robots do, through a reset of one of them."""
    chain = ActuatorChain((effect,))
    batch, single = (
        BatchPlant(ROBOT, GROUND, 2, chain=chain, threads=1),
        Plant(ROBOT, GROUND, chain=chain),
    )
    together = np.broadcast_to(np.zeros(12), (2, 12))
    for k in range(20):
        target = ROBOT.stand_pose + 0.1 * np.sin(0.3 * k)
        told = command(target)
        both = JointCommand(
            **{
                f: getattr(told, f) + together
                for f in ("position", "velocity", "kp", "kd", "torque")
            }
        )
        state, alone = batch.step(both), single.step(told)
        np.testing.assert_allclose(state.joint_position[0], alone.joint_position, atol=1e-9)
        np.testing.assert_allclose(state.joint_velocity[0], alone.joint_velocity, atol=1e-7)
        if k == 10:
            batch.reset(np.array([1]))


def test_a_base_that_rolls_answers_its_legs() -> None:
    """Legs that swing to one side turn a base that hangs freely to the other.

    The angular momentum stays near nothing.

    A base that nothing holds has no such effect.
    """
    free, rigid = (
        Plant(ROBOT, GROUND, body=BodyChain((BaseRoll(give=give),)), held=True)
        for give in (10.0, 0.0)
    )
    aside = ROBOT.stand_pose + np.tile((0.2, 0.0, 0.0), 4)
    for _ in range(50):
        free.step(command(aside))
        rigid.step(command(aside))
    rolls = [
        float(roll_pitch_yaw(rotation_matrix(plant.data.qpos[3:7]))[0]) for plant in (free, rigid)
    ]
    assert rolls[0] < -0.02
    assert abs(rolls[1]) < 1e-6
    standing = [
        Plant(ROBOT, GROUND, body=BodyChain(own))
        for own in ((), (BaseRoll(give=0.05, damping=0.2),))
    ]
    ended = [[plant.step(command()) for _ in range(50)][-1] for plant in standing]
    np.testing.assert_array_equal(ended[0].joint_position, ended[1].joint_position)


def test_a_spring_neither_feeds_a_joint_nor_brakes_it() -> None:
    """Legs that swing on stiff springs keep their energy: a step later, torques would feed them."""
    rest, stiffness = ROBOT.stand_pose + 0.1, 40.0
    spring = joint_loads.JointSpring(torque=tuple(stiffness * rest), stiffness=stiffness)
    plant = Plant(ROBOT, GROUND, chain=ActuatorChain((spring,)), held=True)

    def energy() -> float:
        mujoco.mj_energyPos(plant.model, plant.data)
        mujoco.mj_energyVel(plant.model, plant.data)
        return float(
            plant.data.energy.sum() + 0.5 * stiffness * np.sum((plant.data.qpos[7:] - rest) ** 2)
        )

    stored = 0.5 * stiffness * 12 * 0.1**2
    kept = [(plant.step(command(kp=0.0, kd=0.0)), energy())[1] for _ in range(1000)]
    assert max(kept) - min(kept) < 0.01 * stored


def test_a_joint_leans_on_its_stop() -> None:
    """By as much as its stiffness says: 10 Nm at 200 Nm/rad are 50 mrad."""
    stop = joint_loads.EndStop(
        upper=tuple(ROBOT.stand_pose + 0.1), lower=tuple(ROBOT.stand_pose - 0.1), stiffness=200.0
    )
    plant = Plant(ROBOT, GROUND, chain=ActuatorChain((stop,)), held=True)
    for sign in (1.0, -1.0):
        pushed = replace(command(kp=0.0, kd=2.0), torque=sign * 10.0 + ZERO)
        for _ in range(500):
            state = plant.step(pushed)
        np.testing.assert_allclose(state.joint_position, ROBOT.stand_pose + sign * 0.15, atol=0.02)


def test_training_feels_friction() -> None:
    speed = []
    for friction in (0.0, 0.5):
        engine = CpuEngine(ROBOT, 1, 1, threads=1)
        engine.qpos[:] = np.concatenate([[0.0, 0.0, 3.0, 1.0, 0.0, 0.0, 0.0], ROBOT.stand_pose])
        engine.qvel[:, 6:] = 5.0
        engine.set_joints(*(np.full((1, 12), value) for value in (friction, 0.1 * friction, 0.0)))
        for _ in range(10):
            engine.step()
        speed.append(float(np.abs(engine.qvel[:, 6:]).sum()))
    assert speed[1] < 0.9 * speed[0]


def test_the_log_reads_what_the_encoder_reads() -> None:
    true, measured = swings((EncoderBias(bias=0.03), EncoderQuantisation(step=0.01)))
    np.testing.assert_allclose(measured, np.round((true + 0.03) / 0.01) * 0.01, atol=1e-12)


def test_the_stribeck_curve() -> None:
    stiction = joint_loads.Stiction(breakaway=0.4, stribeck_velocity=0.1)
    for velocity, share in ((0.0, 1.0), (0.1, np.exp(-1.0)), (1.0, 0.0)):
        out, _ = stiction.apply(
            Resistance(velocity=ZERO - velocity, friction=ZERO + 0.2, damping=ZERO, armature=ZERO),
            0.0,
            None,
        )
        np.testing.assert_allclose(out.friction, 0.2 + 0.4 * share, atol=1e-9)


def test_sag_is_linear_and_ends() -> None:
    sag = BatterySag(loss_at_end=0.2, duration_s=10.0)
    for time_s, gain in ((-1.0, 1.0), (0.0, 1.0), (5.0, 0.9), (10.0, 0.8), (20.0, 0.8)):
        out, _ = sag.apply(
            DriveTorque(torque=ZERO + 10.0, position=ZERO, velocity=ZERO), time_s, None
        )
        np.testing.assert_allclose(out.torque, 10.0 * gain)


@pytest.mark.parametrize("seed", range(10))
def test_voltage_falls_with_the_power_that_is_taken_and_no_power_is_beyond_the_battery(
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    sag = VoltageSag(per_kw=float(rng.uniform(0.05, 2.0)))
    for scale in (0.0, 1.0, 30.0, 3000.0):
        torque, velocity = scale * rng.normal(size=(2, 4, 12))
        drive = DriveTorque(torque=torque, position=0.0 * torque, velocity=velocity)
        out, on = sag.apply(drive, 0.0, None)
        assert np.all(on == 1.0)
        along = torque * velocity > 0.0
        np.testing.assert_array_equal(out.torque[~along], torque[~along])
        taken_kw = 1e-3 * np.where(along, out.torque * velocity, 0.0).sum(axis=1, keepdims=True)
        left = np.broadcast_to(1.0 - sag.per_kw * taken_kw, torque.shape)
        np.testing.assert_allclose(out.torque[along], (left * torque)[along], rtol=1e-9)
        assert np.all(taken_kw < 1.0 / sag.per_kw)


@pytest.mark.parametrize("seed", range(10))
def test_a_robot_that_goes_out_gives_no_torque_again(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sag = VoltageSag(per_kw=0.1, brown_out=float(rng.uniform(0.3, 0.9)))
    power_w = 1e3 * (1.0 / sag.brown_out - 1.0) / sag.per_kw  # at which it goes out
    memory = None
    for share, gives in ((0.99, True), (0.5, True), (1.01, False), (0.0, False), (0.5, False)):
        drive = DriveTorque(torque=ZERO + power_w / 12.0, position=ZERO, velocity=ZERO + share)
        out, memory = sag.apply(drive, 0.0, memory)
        assert bool(np.all(out.torque > 0.0)) is gives
        assert gives or not out.torque.any()


def test_a_filtered_ramp_is_late_by_the_time_constant() -> None:
    low_pass, state = VelocityFilter(time_constant=0.01), None
    for k in range(100):
        out, state = low_pass.apply(
            EncoderReading(position=ZERO, velocity=ZERO + k * PHYSICS_DT), 0.0, state
        )
    np.testing.assert_allclose(out.velocity, 99 * PHYSICS_DT - 0.01, atol=1e-6)


def test_play_is_as_wide_as_it_says_and_loses_no_momentum() -> None:
    """A motor that is pushed to and fro against a joint that does not move goes by the width.

    On its way it transmits nothing and the joint lacks its inertia; when it arrives, what the
    torque has given it.
    """
    play, state = Backlash(width=0.02).fitted(ROBOT), None
    offsets, torques, missing = [], [], []
    for k in range(80):
        torque = 0.5 if (k // 20) % 2 == 0 else -0.5
        out, state = play.apply(
            DriveTorque(torque=ZERO + torque, position=ZERO, velocity=ZERO), 0.0, state
        )
        offsets.append(state[0][0])
        torques.append(float(out.torque[0]))
        missing.append(float(play.missing(state)[0]))
    assert (max(offsets), min(offsets)) == pytest.approx((0.01, -0.01))
    np.testing.assert_array_equal(np.array(missing) > 0.0, np.array(torques) == 0.0)
    for start in (20, 40, 60):
        assert sum(torques[start : start + 20]) == pytest.approx(20 * torques[start + 19])
        crossing = np.sum(np.array(torques[start : start + 20]) == 0.0) * PHYSICS_DT
        assert crossing == pytest.approx(
            np.sqrt(2.0 * 0.02 * ROBOT.armature[0] / 0.5), abs=2.0 * PHYSICS_DT
        )


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_the_law_sees_the_motor_and_the_log_the_side_of_its_encoder(share: float) -> None:
    """Joints at one end of their gaps: what is logged is ahead by a share of half of it,
    the law always by all.
    """
    width, kp = 0.02, 30.0
    chain = ActuatorChain((Backlash(width=width, motor_side=share),)).fitted(ROBOT)
    command = JointCommand(position=ZERO + 0.1, velocity=ZERO, kp=ZERO + kp, kd=ZERO, torque=ZERO)
    _, state = chain.step(command, ZERO, ZERO, np.zeros(()), (None,))
    torques, state = chain.step(command, ZERO, ZERO, np.zeros(()), state)
    logged = chain.measured(ZERO, ZERO, np.zeros(()), state)
    np.testing.assert_allclose(logged.position, share * 0.5 * width, atol=1e-12)
    np.testing.assert_allclose(torques.believed, kp * (0.1 - 0.5 * width), atol=1e-9)
    assert chain.senses_otherwise == (share > 0.0)
