"""Laws of compiled drives: they are the drives on numpy, whatever the effects."""

from typing import Any

import numpy as np
import pytest
from samples import ROBOT

from saltus.effects import joint_loads, motors
from saltus.effects.backlash import Backlash
from saltus.effects.chain import ActuatorChain, Torques
from saltus.effects.compiled_chain import compiled_step
from saltus.effects.delay_line import CommandDelay, FeedforwardDelay
from saltus.effects.effect import Effect
from saltus.effects.encoders import EncoderBias, EncoderQuantisation, VelocityFilter, VelocityScale
from saltus.effects.profile import load_profile
from saltus.joint_command import JointCommand

GAINS = tuple(np.linspace(0.5, 1.5, 12))
EFFECTS: tuple[Effect[Any], ...] = (
    CommandDelay(delay=0.007), FeedforwardDelay(delay=0.0113),
    EncoderBias(bias=0.03), EncoderQuantisation(step=0.01), VelocityFilter(time_constant=0.01),
    VelocityScale(scale=1.2),
    motors.ActuatorLag(time_constant=0.004),
    motors.TorqueSpeedLimit(corner=5.0, no_load=20.0),
    motors.TorqueSaturation(knee=8.0, plateau=12.0),
    motors.TorqueGain(gain=GAINS), motors.BatterySag(loss_at_end=0.3, duration_s=1.0),
    motors.VoltageSag(per_kw=0.5, brown_out=0.3),
    Backlash(width=0.02), joint_loads.JointSpring(torque=0.5, stiffness=2.0),
    joint_loads.EndStop(upper=tuple(ROBOT.stand_pose + 0.1)),
    joint_loads.ViscousFriction(coefficient=0.4), joint_loads.CoulombFriction(torque=0.5),
    joint_loads.Stiction(breakaway=0.5, stribeck_velocity=0.5), joint_loads.Armature(added=0.01),
)  # fmt: skip
SHIPPED = load_profile("shipped", ROBOT).actuator_chain.effects
CHAINS = [*((effect,) for effect in EFFECTS), EFFECTS, SHIPPED]
NAMES = [*(effect.name for effect in EFFECTS), "all", "shipped"]


def drawn_steps(count: int) -> list[tuple[Any, ...]]:
    """Commands, and positions and velocities of joints that move as they like."""
    rng = np.random.default_rng(count)
    scales = np.array([0.3, 3.0, 20.0, 1.0, 10.0])[:, None, None] * np.ones((5, count, 12))
    position, velocity, kp, kd, torque = scales * rng.normal(size=scales.shape)
    joints = (0.3 * rng.normal(size=(count, 12)), 10.0 * rng.normal(size=(count, 12)))
    return [
        (
            JointCommand(
                position=ROBOT.stand_pose + position[k], velocity=velocity[k], kp=abs(kp[k]),
                kd=abs(kd[k]), torque=torque[k],
            ),
            ROBOT.stand_pose + joints[0][k], joints[1][k], 0.002 * k,
        )
        for k in range(count)
    ]  # fmt: skip


def assert_alike(one: Torques, other: Torques) -> None:
    np.testing.assert_allclose(one.applied, other.applied, atol=1e-9)
    np.testing.assert_allclose(one.believed, other.believed, atol=1e-9)
    assert (one.resistance is None) == (other.resistance is None)
    for name, values in vars(one.resistance).items() if one.resistance else ():
        np.testing.assert_allclose(values, getattr(other.resistance, name), atol=1e-9)


@pytest.mark.sample(7)
@pytest.mark.parametrize("effects", CHAINS, ids=NAMES)
def test_compiled_drives_are_the_drives(effects: tuple[Effect[Any], ...]) -> None:
    chain = ActuatorChain(effects).fitted(ROBOT)
    compiled = compiled_step(chain)
    state = other = chain.blank
    for given in drawn_steps(600):
        torques, state = chain.step(*given, state)
        again, other = compiled(*given, other, None)
        assert_alike(torques, again)


def test_robots_that_start_anew_forget() -> None:
    chain = ActuatorChain(EFFECTS).fitted(ROBOT)
    compiled, state, other = compiled_step(chain), chain.blank, chain.blank
    for k, given in enumerate(drawn_steps(60)):
        if k % 20 == 0:
            state = other = chain.blank
        torques, state = chain.step(*given, state)
        again, other = compiled(*given, other, None)
        assert_alike(torques, again)


def test_commands_that_are_not_finite_stay_so() -> None:
    chain = ActuatorChain(SHIPPED).fitted(ROBOT)
    compiled, state = compiled_step(chain), chain.blank
    for command, *given in drawn_steps(5):
        _, state = compiled(command, *given, state, None)
    bad = JointCommand(**{**vars(command), "position": np.full(12, np.nan)})
    torques, _ = compiled(bad, *given, state, None)
    assert not np.isfinite(torques.believed + torques.applied).any()
