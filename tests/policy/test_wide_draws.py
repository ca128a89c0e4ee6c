"""What some robots meet beyond the definition of a trial."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
import torch
from samples import PROFILE, ROBOT

from saltus.constants import PHYSICS_DT
from saltus.effects.chain import ActuatorChain
from saltus.effects.command_delay import CommandDelay
from saltus.errors import ConfigError
from saltus.policy.env.curriculum import CurriculumConfig
from saltus.policy.env.drives import COMMAND, Drives, JointDraws
from saltus.policy.env.env import JumpEnv
from saltus.policy.env.randomisation import RandomisationConfig, WideConfig
from saltus.policy.env.settings import EnvConfig
from saltus.policy.env.views import PRIVILEGED
from saltus.policy.features import SIZE
from saltus.sim import scene
from saltus.sim.batch_engine import BatchEngine
from saltus.sim.engine import Engine
from saltus.sim.layout import BASE_DOF, SOFT_SOLIMP, SOFT_SOLREF_S
from saltus.sim.warp import WarpEngine
from saltus.terrain.batch import BOXES, KINDS
from saltus.wire.messages import JointCommand

N = 44
EVERYWHERE = CurriculumConfig(**dict.fromkeys(KINDS, 1.0))
ALL = WideConfig(share=1.0)


def config(wide: WideConfig) -> EnvConfig:
    return EnvConfig(randomisation=RandomisationConfig(wide=wide), curriculum=EVERYWHERE)


def env_of(wide: WideConfig, engine: Engine | None = None, seed: int = 0) -> JumpEnv:
    return JumpEnv(engine or BatchEngine(ROBOT, N, BOXES, threads=1), config(wide), seed=seed)


def bound(env: JumpEnv) -> torch.Tensor:
    values = torch.tensor([[2.0, 1.0, 0.3, 0.0, 0.0, 0.0, 0.12, 0.0, 0.0, 0.12]])
    return env.config.bounds.normalised(values).expand(env.count, 10)


def ends(wide: WideConfig) -> dict[str, tuple[float, float]]:
    """Least and greatest of each value."""
    usual = RandomisationConfig()
    return {
        "friction": (wide.friction, usual.friction[1]),
        "joint_damping": (0.0, wide.joint_damping),
        "joint_friction": (0.0, wide.joint_friction),
        "armature": (1.0, wide.armature),
        "softness": (0.0, wide.softness),
        "command_delay_s": (0.0, wide.command_delay_s),
        "push_mps": (usual.push_mps, wide.side_push_ns / ROBOT.mass),
    }


def test_each_draw_stays_within_its_range_and_uses_it() -> None:
    env = env_of(ALL)
    seen = {name: getattr(env.memory, name).clone() for name in ends(ALL)}
    for draw in range(10):
        env.episodes.draws.uniform_(generator=torch.Generator().manual_seed(draw))
        env.episodes.reset(torch.ones(N, dtype=torch.bool))
        seen = {name: torch.cat([old, getattr(env.memory, name)]) for name, old in seen.items()}
    for name, (low, high) in ends(ALL).items():
        assert low - 1e-6 <= seen[name].min() < low + 0.15 * (high - low), name
        assert high - 0.15 * (high - low) < seen[name].max() <= high + 1e-6, name


@pytest.mark.parametrize("share", [0.25, 0.75])
def test_a_share_of_the_robots_is_drawn_for(share: float) -> None:
    env = env_of(WideConfig(share=share))
    unusual = []
    for seed in range(20):
        env.episodes.draws.uniform_(generator=torch.Generator().manual_seed(seed))
        env.episodes.reset(torch.ones(N, dtype=torch.bool))
        unusual.append(torch.stack([env.memory.joint_damping > 0.0, env.memory.softness > 0.0]))
    both = torch.stack(unusual).float()
    assert abs(both.mean() - share) < 0.05
    assert abs((both[:, 0] * both[:, 1]).mean() - share**2) < 0.06, "each has a coin of its own"


def test_ranges_grow_with_the_steps_of_the_training() -> None:
    wide = WideConfig(share=1.0, growth_msteps=(100.0, 300.0))
    assert [wide.grown(1e6 * m) for m in (0.0, 100.0, 150.0, 300.0, 900.0)] == [0.0, 0.0, 0.25, 1.0, 1.0]
    env = env_of(wide)
    for steps, grown in ((0.0, 0.0), (2e8, 0.5), (4e8, 1.0)):
        env.episodes.grow(steps)
        env.episodes.draws.uniform_(generator=torch.Generator().manual_seed(1))
        env.episodes.reset(torch.ones(N, dtype=torch.bool))
        greatest = float(env.memory.joint_damping.max())
        assert 0.8 * grown * wide.joint_damping <= greatest <= grown * wide.joint_damping + 1e-6


@pytest.mark.parametrize("kind", [BatchEngine, WarpEngine])
def test_the_engine_gets_what_was_drawn(kind: type[Engine]) -> None:
    engine: Any = kind(ROBOT, N, BOXES, **({"device": "cpu"} if kind is WarpEngine else {"threads": 1}))
    env = env_of(ALL, engine)
    field = engine._fields.__getitem__ if kind is WarpEngine else engine.field
    layout = engine._layout if kind is WarpEngine else engine.layout
    soft, foot = env.memory.softness.numpy()[:, None], layout.robot.stop - 1
    usual = scene.CONTACT_SOLREF[0], *scene.CONTACT_SOLIMP[:3]
    contact = field("geom_solref")[:, foot, :1], field("geom_solimp")[:, foot, :3]
    found = np.concatenate([torch.as_tensor(a).numpy() for a in contact], 1)
    np.testing.assert_allclose(found, usual + soft * (np.array([SOFT_SOLREF_S, *SOFT_SOLIMP]) - usual), atol=1e-6)
    armature = torch.as_tensor(field("dof_armature"))[:, BASE_DOF:]
    np.testing.assert_allclose(armature, env.memory.armature.numpy()[:, None] * ROBOT.armature, rtol=1e-5)
    friction = torch.as_tensor(field("geom_friction"))[:, foot, 0]
    np.testing.assert_allclose(friction, env.memory.friction.numpy(), rtol=1e-6)
    for _ in range(5):
        transition = env.step(bound(env))
    assert transition.critic.shape == (N, SIZE + PRIVILEGED + ALL.draws)
    assert all(torch.isfinite(a).all() for a in (transition.actor, transition.critic, transition.reward))


def test_where_nothing_is_drawn_robots_move_as_with_the_usual_ranges() -> None:
    """Before the ranges have grown; the numbers of the usual draws are other ones, as there are more in a row."""
    env = env_of(WideConfig(share=1.0, growth_msteps=(1.0, 2.0)))
    usual = JumpEnv(BatchEngine(ROBOT, N, BOXES, threads=1), config(WideConfig()), seed=0)
    usual.memory.time_s.zero_()
    for each in (env, usual):
        for f in fields(each.memory):
            if f.name not in ("command_line", "armature", "push_mps"):
                getattr(each.memory, f.name).copy_(getattr(usual.memory, f.name))
        each._engine.qpos[:], each._engine.qvel[:] = usual._engine.qpos, 0.0
        each._engine.warmstart[:] = 0.0
        each._engine.set_terrain(each.courses().boxes())
        each._engine.set_bodies(each.episodes._bodies())
        for _ in range(3):
            each._plan()
            for _ in range(5):
                each._control()
                each._engine.step()
                each._sense()
    np.testing.assert_array_equal(env._engine.qpos, usual._engine.qpos)


@pytest.mark.parametrize("delay_s", [0.0, 0.005, 0.006, 0.015])
def test_late_commands_are_those_of_the_effect(delay_s: float) -> None:
    rng = np.random.default_rng(0)
    chain = ActuatorChain((CommandDelay(delay=delay_s),))
    state = chain.init((3,), rng)
    drives = Drives(ROBOT, 0.012, replace(PROFILE, actuator=()), 0.015)
    line, torques = np.zeros((3, drives.commands, COMMAND)), np.zeros((3, drives.length, 12))
    for tick in range(20):
        position, velocity, kp, kd, torque, q, dq = rng.normal(size=(7, 3, 12))
        command = JointCommand(position=position, velocity=velocity, kp=kp, kd=kd, torque=torque)
        expected, state = chain.step(command, q, dq, 0.0, state)
        late, line = drives.late(command, line, np.full(3, delay_s), np.full(3, tick == 0))
        found, torques = drives.step(late, q, dq, torques, np.zeros(3), np.ones(3))
        np.testing.assert_allclose(found, expected.applied, atol=1e-9)


def test_friction_and_damping_of_joints_resist_and_turn_no_rotor_round() -> None:
    drives = Drives(ROBOT, 0.012, replace(PROFILE, actuator=()))
    zero, one = np.zeros((2, 12)), np.ones((2, 12))
    command = JointCommand(position=zero, velocity=zero, kp=zero, kd=zero, torque=zero)
    joints = JointDraws(friction=np.array([0.3, 0.0]), damping=np.array([0.2, 0.0]), armature=np.array([2.0, 1.0]))
    line = np.zeros((2, drives.length, 12))
    fast, _ = drives.step(command, zero, 5.0 * one, line, np.zeros(2), np.ones(2), joints)
    np.testing.assert_allclose(fast, [[-0.3 - 0.2 * 5.0] * 12, [0.0] * 12])
    slow, _ = drives.step(command, zero, -1e-3 * one, line, np.zeros(2), np.ones(2), joints)
    np.testing.assert_allclose(slow[0] * PHYSICS_DT, 2.0 * 1e-3 * ROBOT.armature)


def test_refuses_what_means_nothing() -> None:
    for bad in ({"share": 1.5}, {"growth_msteps": (3.0, 2.0)}, {"softness": 2.0}, {"command_delay_s": -0.1}):
        with pytest.raises(ConfigError):
            WideConfig(**bad)
