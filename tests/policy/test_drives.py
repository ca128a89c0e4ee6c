import numpy as np
import pytest
import torch
from samples import PROFILE, ROBOT

from saltus.constants import PHYSICS_DT
from saltus.effects.chain import ActuatorChain
from saltus.effects.command_delay import CommandDelay
from saltus.effects.feedforward_delay import FeedforwardDelay
from saltus.effects.offsets_and_factors import CoulombFriction, TorqueGain, ViscousFriction
from saltus.effects.profile import Profile
from saltus.policy.env.drives import Drives
from saltus.wire.messages import JointCommand

N = 5


@pytest.mark.parametrize("delay_s", [0.0, 0.007, 0.010, 0.012])
@pytest.mark.parametrize("xp", [np, torch])
def test_equals_the_effects_of_a_profile(delay_s, xp):
    rng = np.random.default_rng(0)
    others = tuple(e for e in PROFILE.actuator if not isinstance(e, FeedforwardDelay))
    chain = ActuatorChain((*others, FeedforwardDelay(delay=delay_s), TorqueGain(gain=0.95))).fitted(ROBOT)
    state = chain.init((N,), rng)
    drives = Drives(ROBOT, 0.012, PROFILE)
    line = xp.zeros((N, drives.length, 12)) if xp is np else torch.zeros(N, drives.length, 12, dtype=torch.float64)
    for tick in range(20):
        arrays = rng.normal(size=(7, N, 12)) * np.array([1, 1, 30, 1, 15, 1, 10])[:, None, None]
        if tick < drives.length:
            arrays[4] = 0.0  # the chain takes the first torque to have been there for long, the drives none
        position, velocity, kp, kd, torque, q, dq = (a if xp is np else torch.as_tensor(a) for a in arrays)
        command = JointCommand(position=position, velocity=velocity, kp=kp, kd=kd, torque=torque)
        expected, state = chain.step(command, q, dq, 0.0, state)
        one = line[:, 0, 0] * 0.0 + 1.0
        found, line = drives.step(command, q, dq, line, delay_s * one, 0.95 * one)
        np.testing.assert_allclose(found, expected.applied, atol=1e-9)


def test_gain_and_friction_of_a_profile_act_and_what_needs_a_memory_is_said_to_be_missing(caplog):
    friction = CoulombFriction(torque=0.3)
    profile = Profile(
        actuator=(friction, ViscousFriction(coefficient=0.2), TorqueGain(gain=0.8), CommandDelay(delay=0.01))
    )
    drives = Drives(ROBOT, 0.012, profile)
    assert "command_delay" in caplog.text
    zero, one = np.zeros((1, 12)), np.ones((1, 12))
    line = np.zeros((1, drives.length, 12))
    command = JointCommand(position=10.0 * one, velocity=zero, kp=one, kd=zero, torque=zero)
    fast, _ = drives.step(command, zero, 5.0 * one, line, np.zeros(1), np.ones(1))
    np.testing.assert_allclose(fast, 0.8 * 10.0 - 0.3 - 0.2 * 5.0)
    at_rest, _ = drives.step(command, zero, zero, line, np.zeros(1), np.ones(1))
    np.testing.assert_allclose(at_rest, 8.0)
    slow, _ = drives.step(command, zero, -1e-3 * one, line, np.zeros(1), np.ones(1))
    assert np.all((slow > 8.0) & ((slow - 8.0) * PHYSICS_DT < 1.001e-3 * ROBOT.armature)), (
        "friction turns no joint round"
    )
