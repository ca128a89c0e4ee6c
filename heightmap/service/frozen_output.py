"""Notices a network whose answer no longer depends on what it is asked."""

import numpy as np

from saltus.heightmap.service.sight import NetworkInputs, NetworkOutputs

FROZEN_NS = 1_000_000_000
"""A trotting or bounding robot goes through two cycles in this time: no terrain looks the same to
the last bit."""


class FrozenOutput:
    """Watches for outputs that stay the same, to the bit, while the inputs change."""

    def __init__(self) -> None:
        self._since_ns = 0
        self._told = b""
        self._inputs: NetworkInputs | None = None

    def step(self, inputs: NetworkInputs, tick: NetworkOutputs, time_ns: int) -> bool:
        """True where the output has been the same for more than a second,
        at the time of a robot state.
        """
        told, asked = tick.values[:, : 2 * tick.points].tobytes(), self._inputs
        if asked is None or told != self._told:
            self._since_ns, self._told, self._inputs = time_ns, told, inputs
            return False
        return time_ns - self._since_ns > FROZEN_NS and not _same_input(asked, inputs)


def _same_input(left: NetworkInputs, right: NetworkInputs) -> bool:
    """Image and features: the age of an image changes with every tick, whatever there is to see."""
    return np.array_equal(left.image, right.image) and np.array_equal(left.features, right.features)
