"""The drives of a training are those of the plant: every effect of an actuator, none left out."""

from dataclasses import fields
from typing import Any

import numpy as np
import pytest
import torch
from samples import EVERYTHING, PROFILE, ROBOT

from saltus.constants import PHYSICS_DT
from saltus.effects.chain import ActuatorChain
from saltus.effects.command_delay import CommandDelay
from saltus.effects.effect import Effect
from saltus.effects.feedforward_delay import FeedforwardDelay
from saltus.effects.offsets_and_factors import (
    ContactCompliance,
    SoftFeet,
    TorqueGain,
)
from saltus.effects.profile import Profile, profile_to_toml
from saltus.errors import ConfigError
from saltus.policy.env.env import JumpEnv
from saltus.policy.env.randomisation import RandomisationConfig, WideConfig
from saltus.policy.env.settings import EnvConfig
from saltus.sim.batch import BatchPlant
from saltus.sim.batch_engine import BatchEngine
from saltus.sim.engine import MEDIUM_PAYLOAD_KG
from saltus.sim.plant import Plant
from saltus.sim.warp import WarpEngine
from saltus.terrain import flat
from saltus.terrain.batch import BOXES
from saltus.trial import NOMINAL_FEEDFORWARD_DELAY_S
from saltus.wire.messages import JointCommand

ACTUATOR = EVERYTHING.actuator
STEPS = 80
HIGH = 2.0  # above the ground [m]: the robot falls for longer
BATCH_RAD, TRAINING_RAD = 1e-8, 2e-4
"""How far joints of the batch, and of a training in single precision, may be from those of the plant."""
USUAL = RandomisationConfig(
    payload_kg=(MEDIUM_PAYLOAD_KG,) * 2,
    motor_strength=(1.0, 1.0),
    com_shift_m=(0.0, 0.0, 0.0),
    feedforward_delay_s=(NOMINAL_FEEDFORWARD_DELAY_S,) * 2,
)


def commands() -> list[JointCommand]:
    """A random motion whose torques and speeds reach all limits."""
    rng, told = np.random.default_rng(0), []
    position, torque = ROBOT.stand_pose.copy(), np.zeros(12)
    for k in range(STEPS):
        if k % 8 == 0:
            position, torque = ROBOT.stand_pose + rng.normal(0.0, 0.3, 12), rng.normal(0.0, 6.0, 12)
        zero = np.zeros(12)
        told.append(JointCommand(position=position, velocity=zero, kp=zero + 60.0, kd=zero + 1.0, torque=torque))
    return told


def each(command: JointCommand, make: Any) -> JointCommand:
    return JointCommand(**{f.name: make(getattr(command, f.name)) for f in fields(command)})


def of_plant(effects: tuple[Effect[Any], ...]) -> np.ndarray:
    plant = Plant(ROBOT, flat.make(), payload_kg=MEDIUM_PAYLOAD_KG, chain=ActuatorChain(effects))
    plant.reset(clearance=HIGH)
    return np.array([plant.step(command).joint_position for command in commands()])


def of_batch(effects: tuple[Effect[Any], ...]) -> np.ndarray:
    plant = BatchPlant(ROBOT, flat.make(), 2, payload_kg=MEDIUM_PAYLOAD_KG, chain=ActuatorChain(effects), threads=1)
    plant.reset(clearance=HIGH)
    told = [each(command, lambda a: np.stack([a, a])) for command in commands()]
    return np.array([plant.step(command).joint_position[1] for command in told])


def env_of(profile: Profile, path: Any, engine: Any = None, randomisation: RandomisationConfig = USUAL) -> JumpEnv:
    path.write_text(profile_to_toml(profile))
    config = EnvConfig(profile=str(path), randomisation=randomisation)
    engine = engine or BatchEngine(ROBOT, 2, BOXES, dimensions=profile.body_chain.contact_dimensions, threads=1)
    return JumpEnv(engine, config, seed=0)


def of_training(effects: tuple[Effect[Any], ...], path: Any) -> np.ndarray:
    env = env_of(Profile(actuator=effects), path)
    env.memory.first_time_s.zero_()
    env.memory.time_s.zero_()
    engine, law, others = env._engine, env._law, []
    start = Plant(ROBOT, flat.make())
    start.reset(clearance=HIGH)
    engine.qpos[:], engine.qvel[:] = start.data.qpos, 0.0
    engine.trunk_wrench[:] = 0.0
    positions = []
    for told in commands():

        class Told:
            """The law is asked once: its gait and state, which are not looked at, stay those of the start."""

            def step(self, *now: Any) -> Any:
                others.extend([] if others else law.step(*now)[1:])
                return each(told, lambda a: torch.tensor(np.stack([a, a])).float()), *others  # noqa: B023

        env._law = Told()  # type: ignore[assignment]
        env._control()
        engine.step()
        env._sense()
        positions.append(env.states().joint_position[1].numpy())
    return np.array(positions)


def test_there_is_an_example_of_every_effect() -> None:
    assert {type(effect) for effect in ACTUATOR} == set(ActuatorChain.order)


@pytest.mark.parametrize("effects", [*((effect,) for effect in ACTUATOR), ACTUATOR], ids=lambda e: e[0].name)
def test_every_simulator_has_the_drives_of_the_plant(effects: tuple[Effect[Any], ...], tmp_path: Any) -> None:
    plant = of_plant(effects)
    assert np.abs(plant - of_plant(())).max() > 20.0 * TRAINING_RAD, "the motion shows the effect"
    assert np.abs(of_batch(effects) - plant).max() < BATCH_RAD
    assert np.abs(of_training(effects, tmp_path / "p.toml") - plant).max() < TRAINING_RAD


def test_draws_are_around_what_the_profile_says(tmp_path: Any) -> None:
    ranges = RandomisationConfig(wide=WideConfig(share=1.0))
    found = Profile(actuator=(FeedforwardDelay(delay=0.04), CommandDelay(delay=0.003), TorqueGain(gain=0.7)))
    env = env_of(found, tmp_path / "found.toml", BatchEngine(ROBOT, 64, BOXES, threads=1), ranges)
    effects: dict[str, Any] = {effect.name: effect for effect in env._drives.effects}
    like = torch.zeros(64, 12)
    for name, parameter, low, high in (
        ("feedforward_delay", "delay", 0.038, 0.042),
        ("command_delay", "delay", 0.003, 0.018),
        ("torque_gain", "gain", 0.63, 0.77),
        ("viscous_friction", "coefficient", 0.0, 0.3),
    ):
        value = effects[name].value(parameter, like)
        room = 0.1 * (high - low)
        assert low - 1e-6 <= value.min() < low + 3.0 * room, name  # small draws are rare
        assert high - room < value.max() <= high + 1e-6, name


def test_where_a_profile_has_no_delay_none_is_drawn(tmp_path: Any) -> None:
    env = env_of(Profile(), tmp_path / "ideal.toml")
    assert [effect.name for effect in env._drives.effects] == ["torque_gain"]


@pytest.mark.filterwarnings("ignore:Dynamo detected a call to a `functools.lru_cache`")
def test_no_stage_asks_what_its_numbers_are(tmp_path: Any) -> None:
    """With all effects of drives, bodies and IMUs each stage is one graph for a GPU to replay."""
    ranges = RandomisationConfig(wide=WideConfig(share=0.5))
    env = env_of(EVERYTHING, tmp_path / "all.toml", WarpEngine(ROBOT, 2, BOXES, dimensions=6, device="cpu"), ranges)
    env.step(torch.zeros(2, 10))  # what is computed once and kept is not to be traced
    for stage in env.stages:
        torch.compile(stage._function, backend="eager", dynamic=False, fullgraph=True)()
    assert all(torch.isfinite(a).all() for a in (env.views.actor, env.views.critic))


def test_bodies_and_imus_are_those_of_the_profile(tmp_path: Any) -> None:
    env, plain = (env_of(profile, tmp_path / "p.toml") for profile in (EVERYTHING, Profile()))
    assert (env.episodes._bodies().payload_kg - plain.episodes._bodies().payload_kg == 0.5).all()
    for _ in range(3):
        env.step(torch.zeros(2, 10))
    turned = env.states().angular_velocity_base - torch.as_tensor(env._engine.qvel)[:, 3:6]
    assert (turned.abs() > 1e-6).all(), "the IMU is wrong and late"


def test_what_a_training_cannot_hold_is_refused_by_name(tmp_path: Any) -> None:
    soft = Profile(body=(SoftFeet(torsion=0.01),))
    with pytest.raises(ConfigError, match="soft_feet"):
        env_of(soft, tmp_path / "soft.toml", BatchEngine(ROBOT, 2, BOXES, threads=1))


def test_contacts_are_drawn_around_those_of_the_profile(tmp_path: Any) -> None:
    soft = Profile(body=(ContactCompliance(time_constant=0.01), SoftFeet(touch=0.5)))
    env = env_of(soft, tmp_path / "soft.toml", randomisation=RandomisationConfig(wide=WideConfig(share=1.0)))
    bodies, softness = env.episodes._bodies(), env.memory.softness
    assert torch.allclose(bodies.contact_time_constant.float(), 2.0 * (0.005 + 0.015 * softness))
    assert torch.allclose(bodies.touch_impedance.float(), 0.5 / 0.95 * (0.95 - 0.93 * softness))


def test_before_its_first_command_a_drive_holds_the_first_and_has_no_feedforward() -> None:
    chain = ActuatorChain((CommandDelay(delay=0.004), FeedforwardDelay(delay=0.004)))
    (first, second), state = commands()[:2], chain.blank
    found = []
    for command in (first, second, second, second, second):
        torques, state = chain.step(command, ROBOT.stand_pose, np.zeros(12), 0.0, state)
        found.append(torques.applied)
    feedback = first.kp * (first.position - ROBOT.stand_pose)
    np.testing.assert_allclose(found[:2], [feedback] * 2)
    np.testing.assert_allclose(found[4], feedback + first.torque)


def test_gains_of_the_default_profile_cost_what_they_did() -> None:
    """Of the shipped profile only feed-forward torque is remembered: a training keeps no other state of its drives."""
    chain = PROFILE.actuator_chain.fitted(ROBOT)
    _, state = chain.step(commands()[0], ROBOT.stand_pose, np.zeros(12), 0.0, chain.blank)
    assert [memory is not None for memory in state] == [effect.name == "feedforward_delay" for effect in chain.effects]
    assert state[0].shape == (int(0.010 / PHYSICS_DT) + 2, 1, 12)
