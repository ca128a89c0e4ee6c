"""Every effect in every simulator of robots: held as the plant holds it, or refused by name.

None is dropped.

Those of cameras have their own simulators and laws, in tests/heightmap/test_camera_family.py.
"""

from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from samples import EVERYTHING, PROFILE, ROBOT, setups_of

from saltus.cli.main import main
from saltus.config import TerrainConfig
from saltus.constants import PHYSICS_DT, POLICY_DT
from saltus.effects.body import NOMINAL_FRICTION, ContactCompliance, PayloadMass, SoftFeet
from saltus.effects.chain import ActuatorChain
from saltus.effects.delay_line import CommandDelay, FeedforwardDelay
from saltus.effects.heightmap_shift import HeightmapShift
from saltus.effects.motors import TorqueGain
from saltus.effects.profile import EFFECTS, Profile
from saltus.errors import ConfigError
from saltus.grid import HEIGHTMAP_X, LINE
from saltus.joint_command import JointCommand
from saltus.loop.loop import Loop
from saltus.policy.env.jump_env import JumpEnv, _reading, engine_states
from saltus.policy.env.randomisation import RandomisationSettings, WideSettings
from saltus.policy.env.settings import JumpEnvSettings
from saltus.policy.env.training_env import EnvStage
from saltus.policy.scripted import ScriptedPlanner
from saltus.sim.batch_plant import BatchPlant
from saltus.sim.cpu_engine import CpuEngine
from saltus.sim.engine import MEDIUM_PAYLOAD_KG
from saltus.sim.plant import CLEARANCE, Plant
from saltus.sim.warp_engine import WarpEngine
from saltus.states import SensorArrays
from saltus.terrain import flat
from saltus.terrain.course_batch import BOXES
from saltus.terrain.curriculum import make_terrain
from saltus.trial import NOMINAL_FEEDFORWARD_DELAY_S, Trial

ACTUATOR = EVERYTHING.actuator
BODY = (*EVERYTHING.body, ContactCompliance(time_constant=0.012))
ROBOTS = {"actuator": ACTUATOR, "body": BODY, "imu": EVERYTHING.imu}
OF_STANDS = tuple(effect for effect in EVERYTHING.body if effect.site == "stand")
"""Of what holds a robot in the air, which only a plant does."""
FAMILY = [
    Profile(**{part: (effect,)})  # type: ignore[arg-type]
    for part, effects in ROBOTS.items()
    for effect in effects
    if effect not in OF_STANDS
]
SHIFT = HeightmapShift(x=0.1, z=-0.07)
STEPS = 56
HIGH = 2.0  # above the ground [m]: the robot falls for longer
BATCH_RAD, TRAINING_RAD = 1e-8, 1e-5
"""How far what robots sense in the batch, and in a training in single precision, may be from that
of the plant."""
SHOWS_RAD = 4e-3  # at least, of each effect
USUAL = RandomisationSettings(
    friction=(NOMINAL_FRICTION,) * 2,
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
        told.append(
            JointCommand(
                position=position, velocity=zero, kp=zero + 60.0, kd=zero + 1.0, torque=torque
            )
        )
    return told


def each(command: JointCommand, make: Any) -> JointCommand:
    return JointCommand(**{f.name: make(getattr(command, f.name)) for f in fields(command)})


def clearance_of(profile: Profile) -> float:
    """What is wrong with bodies and ground shows where robots stand,
    what is wrong with drives where they do not.
    """
    return CLEARANCE if profile.body else HIGH


def what_is(profile: Profile) -> dict[str, Any]:
    return {
        "payload_kg": MEDIUM_PAYLOAD_KG,
        "chain": profile.actuator_chain,
        "body": profile.body_chain,
        "imu": profile.imu_chain,
    }


def angles(sensed: SensorArrays) -> np.ndarray:
    """What encoders and IMUs say, as angles [rad]: how far the base turns within 10 ms, too."""
    turned = POLICY_DT * np.asarray(sensed.angular_velocity_base)
    return np.concatenate([sensed.joint_position, sensed.quaternion_base_in_world, turned], axis=-1)


def of_plant(profile: Profile, *, held: bool = False) -> np.ndarray:
    plant = Plant(ROBOT, flat.make(), held=held, **what_is(profile))
    plant.reset(clearance=clearance_of(profile))
    return np.array([(plant.step(command), angles(plant.sensed))[1] for command in commands()])


of_plain_plant = cache(of_plant)
"""What no effect or one of no size does is asked again and again."""


def of_batch(profile: Profile) -> np.ndarray:
    plant = BatchPlant(ROBOT, flat.make(), 2, threads=1, **what_is(profile))
    plant.reset(clearance=clearance_of(profile))
    told = [each(command, lambda a: np.stack([a, a])) for command in commands()]
    return np.array([(plant.step(command), angles(plant.sensed)[1])[1] for command in told])


def env_of(
    profile: Profile, path: Any, engine: Any = None, randomisation: RandomisationSettings = USUAL
) -> JumpEnv:
    path.write_text(profile.to_toml())
    config = JumpEnvSettings(profile=str(path), randomisation=randomisation)
    engine = engine or CpuEngine(
        ROBOT, 2, BOXES, dimensions=config.contact_dimensions(profile), threads=1
    )
    return JumpEnv(engine, config, LINE, seed=0)


def of_training(profile: Profile, path: Any) -> np.ndarray:
    env = env_of(profile, path)
    env.memory.first_time_s.zero_()
    env.memory.time_s.zero_()
    engine, law, others = env._engine, env._law, []
    start = Plant(ROBOT, flat.make())
    start.reset(clearance=clearance_of(profile))
    engine.qpos[:], engine.qvel[:] = start.data.qpos, 0.0
    engine.trunk_wrench[:] = 0.0
    if env._imu.effects:
        env.memory.imu = env._imu.step(
            _reading(engine_states(engine, env.memory)), env._time_s(), env._imu.blank
        )
    sensed = []
    for told in commands():

        class Told:
            """The law is asked once: its gait and state,
            which are not looked at, stay those of the start.
            """

            def step(self, *now: Any) -> Any:
                others.extend([] if others else law.step(*now)[1:])
                return each(told, lambda a: torch.tensor(np.stack([a, a])).float()), *others  # noqa: B023

        env._law = Told()  # type: ignore[assignment]
        env._control()
        engine.step()
        env._sense()
        sensed.append(angles(env.states())[1])
    return np.array(sensed)


def test_there_is_an_example_of_every_effect() -> None:
    examples = (*ACTUATOR, *BODY, *EVERYTHING.imu, *EVERYTHING.camera, SHIFT)
    assert {effect.name for effect in examples} == set(EFFECTS)


@pytest.mark.sample(6)
@pytest.mark.parametrize(
    "profile",
    [*FAMILY, Profile(actuator=ACTUATOR, imu=EVERYTHING.imu)],
    ids=lambda profile: next(iter(profile.effects)),
)
def test_every_simulator_has_the_robots_of_the_plant(profile: Profile, tmp_path: Any) -> None:
    plant = of_plant(profile)
    nothing = of_plain_plant(Profile(body=(PayloadMass(),)) if profile.body else Profile())
    assert np.abs(plant - nothing).max() > SHOWS_RAD, "the motion shows the effect"
    assert np.abs(of_batch(profile) - plant).max() < BATCH_RAD
    assert np.abs(of_training(profile, tmp_path / "p.toml") - plant).max() < TRAINING_RAD


@pytest.mark.parametrize("effect", OF_STANDS, ids=lambda effect: effect.name)
def test_what_holds_a_robot_shows_where_one_is_held_and_nowhere_else(
    effect: Any, tmp_path: Any
) -> None:
    profile, nothing = Profile(body=(effect,)), Profile()
    assert np.abs(of_plant(profile, held=True) - of_plant(nothing, held=True)).max() > SHOWS_RAD
    free = of_plant(Profile(body=(PayloadMass(),)))
    assert np.array_equal(of_plant(profile), free)
    assert np.array_equal(of_batch(profile), of_batch(Profile(body=(PayloadMass(),))))
    assert np.abs(of_training(profile, tmp_path / "p.toml") - free).max() < TRAINING_RAD


def test_true_heights_are_shifted_alike_in_rollouts_and_in_training(tmp_path: Any) -> None:
    profile, terrain = Profile(heightmap=(SHIFT,)), make_terrain(TerrainConfig(terrain="stairs"))
    rollout = Loop(
        setups_of([terrain], [Trial(position_x=1.2)], profile), ScriptedPlanner(ROBOT, LINE)
    )
    step = rollout.step()
    position = step.truth.position_base_in_world[0]
    seen = terrain.height_at(position[0] + HEIGHTMAP_X + SHIFT.x, 0.0) - position[2] + SHIFT.z
    np.testing.assert_allclose(step.heights[0], seen, atol=1e-9)
    drawn = env_of(
        profile, tmp_path / "p.toml", CpuEngine(ROBOT, 64, BOXES, threads=1)
    ).memory.height_shift
    spread = (drawn - torch.tensor([SHIFT.x, SHIFT.z])).abs().amax(0)
    np.testing.assert_allclose(spread, RandomisationSettings().height_shift_m, rtol=0.1)
    assert (spread <= torch.tensor(RandomisationSettings().height_shift_m) + 1e-6).all()


@pytest.mark.parametrize(
    "command",
    [
        "demo --profile {profile}",
        "policy eval --heightmap predicted --profile {profile}",
        "policy eval --heightmap true-exact --profile {profile}",
        "heightmap collect cpu --model models/heightmap.onnx --profile {profile}",
        "heightmap collect gpu --device cpu --predictor models/heightmap.onnx --profile {profile}",
        "heightmap dagger --profile {profile}",
        "real2sim cycle --hidden {profile}",
        "real2sim cycle --hidden examples/late_camera.toml --profile {profile}",
    ],
)
def test_who_has_no_true_heights_refuses_their_shift_by_name(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "shifted.toml"
    path.write_text(Profile(heightmap=(SHIFT,)).to_toml())
    assert main([*command.format(profile=path).split(), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr()
    assert "heightmap_shift" in said.err
    assert not (tmp_path / "out").exists()


def test_draws_are_around_what_the_profile_says(tmp_path: Any) -> None:
    ranges = RandomisationSettings(wide=WideSettings(share=1.0))
    found = Profile(
        actuator=(FeedforwardDelay(delay=0.04), CommandDelay(delay=0.003), TorqueGain(gain=0.7))
    )
    env = env_of(
        found,
        tmp_path / "found.toml",
        CpuEngine(ROBOT, 64, BOXES, dimensions=6, threads=1),
        ranges,
    )
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


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Dynamo detected a call to a `functools.lru_cache`")
def test_no_stage_asks_what_its_numbers_are(tmp_path: Any) -> None:
    """With all effects of drives, bodies and IMUs each stage is one graph for a GPU to replay."""
    ranges = RandomisationSettings(wide=WideSettings(share=0.5))
    env = env_of(
        EVERYTHING,
        tmp_path / "all.toml",
        WarpEngine(ROBOT, 2, BOXES, dimensions=6, device="cpu"),
        ranges,
    )
    env.step(torch.zeros(2, 10))  # what is computed once and kept is not to be traced
    for stage in env.stages:
        stage.compiled("eager")()
    assert all(torch.isfinite(a).all() for a in (env.views.actor, env.views.critic))


def test_a_process_compiles_the_stages_of_any_number_of_environments() -> None:
    class Counter:
        def __init__(self, by: float) -> None:
            self.count, self.by = torch.zeros(1), by

        @torch.no_grad()
        def step(self) -> None:
            self.count += self.by

    # What is traced holds for its own numbers alone
    counters = [Counter(float(i)) for i in range(10)]
    for counter in counters:
        EnvStage(counter.step, torch.device("cpu")).compiled("eager")()
    assert all(counter.count == counter.by for counter in counters)


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
        env_of(soft, tmp_path / "soft.toml", CpuEngine(ROBOT, 2, BOXES, threads=1))
    drawn = RandomisationSettings(wide=WideSettings(share=0.5))
    with pytest.raises(ConfigError, match="softness"):
        env_of(Profile(), tmp_path / "claimed.toml", CpuEngine(ROBOT, 2, BOXES, threads=1), drawn)


def test_contacts_are_drawn_around_those_of_the_profile(tmp_path: Any) -> None:
    soft = Profile(body=(ContactCompliance(time_constant=0.01), SoftFeet(touch=0.5)))
    env = env_of(
        soft,
        tmp_path / "soft.toml",
        randomisation=RandomisationSettings(wide=WideSettings(share=1.0)),
    )
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
    """Of the shipped profile only feed-forward torque is remembered:
    a training keeps no other state of its drives.
    """
    chain = PROFILE.actuator_chain.fitted(ROBOT)
    _, state = chain.step(commands()[0], ROBOT.stand_pose, np.zeros(12), 0.0, chain.blank)
    assert [memory is not None for memory in state] == [
        effect.name == "feedforward_delay" for effect in chain.effects
    ]
    assert state[0].shape == (int(0.010 / PHYSICS_DT) + 2, 1, 12)
