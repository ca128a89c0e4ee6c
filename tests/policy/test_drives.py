import numpy as np
import pytest
import torch

from policy.drives import Drives
from saltus.effects.chain import ActuatorChain
from saltus.effects.feedforward_delay import FeedforwardDelay
from saltus.effects.profile import GO1
from saltus.effects.torque_gain import TorqueGain
from saltus.messages import JointCommand

N = 5


@pytest.mark.parametrize("delay_s", [0.0, 0.007, 0.010, 0.012])
@pytest.mark.parametrize("xp", [np, torch])
def test_equals_the_effects_of_a_profile(delay_s, xp):
    rng = np.random.default_rng(0)
    others = tuple(e for e in GO1.actuator if not isinstance(e, FeedforwardDelay))
    chain = ActuatorChain((*others, FeedforwardDelay(delay=delay_s), TorqueGain(gain=0.95)))
    state = chain.init((N,), rng)
    drives = Drives(0.012)
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
