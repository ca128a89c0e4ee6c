"""The effects of the drives of one robot as straight-line Python: half of the time of a physics step."""

import numpy as np

from saltus.arrays import Array, Joints
from saltus.effects.chain import ActuatorChain, ActuatorState, Torques
from saltus.joint_command import JointCommand
from saltus.robots.robot import JOINTS
from saltus.straight_line import straight_line


class CompiledChain:
    """The `step` of a chain, asked for one robot again and again.

    The chain itself, on numpy, is the reference: it makes the first step, which memories have their
    shapes from, and those of robots that are put back to the start.
    """

    def __init__(self, chain: ActuatorChain) -> None:
        self._chain = chain
        zero = np.zeros(len(JOINTS))
        still = JointCommand(position=zero, velocity=zero, kp=zero, kd=zero, torque=zero)
        _, memories = chain.step(still, zero, zero, 0.0, chain.blank)
        self._remembers = _remembers(memories)
        self._law = straight_line(chain.step, still, zero, zero, 0.0, memories)

    def step(
        self,
        command: JointCommand,
        position: Joints,
        velocity: Joints,
        time_s: Array,
        state: ActuatorState,
        fresh: Array | None = None,
    ) -> tuple[Torques, ActuatorState]:
        """See `ActuatorChain.step`."""
        given = (command, position, velocity, time_s, state)
        if fresh is None and _remembers(state) == self._remembers:
            try:
                torques, after = self._law(*given)
            except (ArithmeticError, ValueError):  # numbers that floats cannot work with
                return self._chain.step(*given)
            return torques, after
        return self._chain.step(*given, fresh)


def _remembers(state: ActuatorState) -> tuple[bool, ...]:
    """Which effects have a memory."""
    return tuple(memory is not None for memory in state)
