"""What some robots meet beyond the definition of a trial."""

from dataclasses import fields
from typing import Any

import numpy as np
import pytest
import torch
from samples import ROBOT

from saltus.errors import ConfigError
from saltus.grid import LINE
from saltus.policy.env.curriculum import CurriculumSettings
from saltus.policy.env.env_observations import PRIVILEGED
from saltus.policy.env.jump_env import JumpEnv
from saltus.policy.env.randomisation import SOFT_RUBBER, RandomisationSettings, WideSettings
from saltus.policy.env.settings import JumpEnvSettings
from saltus.policy.policy_features import size_with
from saltus.sim import robot_model
from saltus.sim.cpu_engine import CpuEngine
from saltus.sim.engine import Engine
from saltus.sim.model_layout import BASE_DOF
from saltus.sim.warp_engine import WarpEngine
from saltus.terrain.course_batch import BOXES
from saltus.terrain.course_law import KINDS

N = 44
EVERYWHERE = CurriculumSettings(**dict.fromkeys(KINDS, 1.0))
ALL = WideSettings(share=1.0)


def config(wide: WideSettings) -> JumpEnvSettings:
    return JumpEnvSettings(randomisation=RandomisationSettings(wide=wide), curriculum=EVERYWHERE)


def env_of(wide: WideSettings, engine: Engine | None = None, seed: int = 0) -> JumpEnv:
    engine = engine or CpuEngine(ROBOT, N, BOXES, dimensions=wide.contact_dimensions, threads=1)
    return JumpEnv(engine, config(wide), LINE, seed=seed)


def bound(env: JumpEnv) -> torch.Tensor:
    values = torch.tensor([[2.0, 1.0, 0.3, 0.0, 0.0, 0.0, 0.12, 0.0, 0.0, 0.12]])
    return env.config.bounds.normalised(values).expand(env.count, 10)


def ends(wide: WideSettings) -> dict[str, tuple[float, float]]:
    """Least and greatest of each value."""
    usual = RandomisationSettings()
    return {
        "friction": (wide.friction, usual.friction[1]),
        "joint_damping": (0.0, wide.joint_damping),
        "joint_friction": (0.0, wide.joint_friction),
        "softness": (0.0, wide.softness),
        "command_delay_s": (0.0, wide.command_delay_s),
        "push_mps": (0.0, wide.side_push_ns / ROBOT.mass),
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
    env = env_of(WideSettings(share=share))
    unusual = []
    for seed in range(20):
        env.episodes.draws.uniform_(generator=torch.Generator().manual_seed(seed))
        env.episodes.reset(torch.ones(N, dtype=torch.bool))
        unusual.append(torch.stack([env.memory.joint_damping > 0.0, env.memory.softness > 0.0]))
    both = torch.stack(unusual).float()
    assert abs(both.mean() - share) < 0.05
    assert abs((both[:, 0] * both[:, 1]).mean() - share**2) < 0.06, "each has a coin of its own"


def test_ranges_grow_with_the_steps_of_the_training() -> None:
    wide = WideSettings(share=1.0, growth_msteps=(100.0, 300.0))
    assert [wide.grown(1e6 * m) for m in (0.0, 100.0, 150.0, 300.0, 900.0)] == [
        0.0,
        0.0,
        0.25,
        1.0,
        1.0,
    ]
    env = env_of(wide)
    for steps, grown in ((0.0, 0.0), (2e8, 0.5), (4e8, 1.0)):
        env.episodes.grow(steps)
        env.episodes.draws.uniform_(generator=torch.Generator().manual_seed(1))
        env.episodes.reset(torch.ones(N, dtype=torch.bool))
        greatest = float(env.memory.joint_damping.max())
        assert 0.8 * grown * wide.joint_damping <= greatest <= grown * wide.joint_damping + 1e-6


@pytest.mark.parametrize("kind", [CpuEngine, WarpEngine])
def test_the_engine_gets_what_was_drawn(kind: type[Engine]) -> None:
    more = {"device": "cpu"} if kind is WarpEngine else {"threads": 1}
    engine: Any = kind(ROBOT, N, BOXES, dimensions=ALL.contact_dimensions, **more)
    env = env_of(ALL, engine)
    field = engine._fields.__getitem__ if kind is WarpEngine else engine.field
    layout = engine._layout if kind is WarpEngine else engine.layout
    soft, foot = env.memory.softness.numpy()[:, None], layout.robot.stop - 1
    usual, rubber = np.array(tuple(SOFT_RUBBER.values())).T
    assert usual[:3].tolist() == [
        robot_model.CONTACT_SOLREF[0],
        robot_model.CONTACT_SOLIMP[0],
        robot_model.CONTACT_SOLIMP[2],
    ]
    contact = (
        field("geom_solref")[:, foot, :1],
        field("geom_solimp")[:, foot, :3:2],
        field("geom_friction")[:, foot, 1:],
    )
    found = np.concatenate([torch.as_tensor(a).numpy() for a in contact], 1)
    np.testing.assert_allclose(found, usual + soft * (rubber - usual), atol=1e-6)
    env._control()
    for name, expected in (
        ("dof_frictionloss", np.tile(env.memory.joint_friction.numpy()[:, None], 12)),
        ("dof_damping", np.tile(env.memory.joint_damping.numpy()[:, None], 12)),
    ):
        np.testing.assert_allclose(torch.as_tensor(field(name))[:, BASE_DOF:], expected, rtol=1e-5)
    friction = torch.as_tensor(field("geom_friction"))[:, foot, 0]
    np.testing.assert_allclose(friction, env.memory.friction.numpy(), rtol=1e-6)
    for _ in range(5):
        transition = env.step(bound(env))
    assert transition.critic.shape == (N, size_with(LINE) + PRIVILEGED + ALL.draws)
    assert all(
        torch.isfinite(a).all() for a in (transition.actor, transition.critic, transition.reward)
    )


def test_where_nothing_is_drawn_robots_move_as_with_the_usual_ranges() -> None:
    """Before the ranges have grown.

    The numbers of the usual draws are other ones, as there are more in a row.
    """
    env = env_of(WideSettings(share=1.0, growth_msteps=(1.0, 2.0)))
    usual = JumpEnv(
        CpuEngine(ROBOT, N, BOXES, dimensions=6, threads=1), config(WideSettings()), LINE, seed=0
    )
    usual.memory.time_s.zero_()
    for each in (env, usual):
        for f in fields(each.memory):
            if f.name not in ("actuators", "imu", "push_mps"):
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


def test_refuses_what_means_nothing() -> None:
    for bad in (
        {"share": 1.5},
        {"growth_msteps": (3.0, 2.0)},
        {"softness": 2.0},
        {"command_delay_s": -0.1},
    ):
        with pytest.raises(ConfigError):
            WideSettings(**bad)
