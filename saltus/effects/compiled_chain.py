"""The effects of the drives of one robot as straight-line Python:
half of the time of a physics step.
"""

from collections.abc import Callable

import numpy as np

from saltus.arrays import Array, Joints
from saltus.effects.chain import ActuatorChain, ActuatorState, Torques
from saltus.joint_command import JointCommand
from saltus.robots.robot import JOINTS
from saltus.straight_line import straight_line

DriveStep = Callable[
    [JointCommand, Joints, Joints, Array, ActuatorState, Array | None],
    tuple[Torques, ActuatorState],
]
"""`ActuatorChain.step` of a chain, on numpy or compiled."""


def compiled_step(chain: ActuatorChain) -> DriveStep:
    """The step of a chain that is asked for one robot again and again.

    The chain itself, on numpy, is the reference: it makes the first step, which memories have their
    shapes from, and those of robots that are put back to the start.
    """
    zero = np.zeros(len(JOINTS))
    still = JointCommand(position=zero, velocity=zero, kp=zero, kd=zero, torque=zero)
    _, memories = chain.step(still, zero, zero, 0.0, chain.blank)
    law = straight_line(chain.step, still, zero, zero, 0.0, memories)
    # One effect with a memory tells of all whether they have begun
    told = next((i for i, memory in enumerate(memories) if memory is not None), None)

    def step(*given: Array) -> tuple[Torques, ActuatorState]:
        *now, state, fresh = given
        if fresh is None and (told is None or state[told] is not None):
            try:
                torques, after = law(*now, state)
            except (ArithmeticError, ValueError):  # numbers that floats cannot work with
                return chain.step(*given)
            return torques, after
        return chain.step(*given)

    return step
