"""Acts of an operator on a simulated robot: pushes from the side, like those of evaluations."""

import math

from saltus.constants import POLICY_DT, PUSH_STEPS
from saltus.wire.bus import Bus
from saltus.wire.messages import OPERATOR

HARDEST_NS = 100.0
"""[Ns]: a robot of 13 kg is then thrown sideways at 8 m/s."""


class TrunkShove:
    """Obeys "push", whose detail is the impulse towards the left of the course [Ns],
    negative to the right.

    It lasts 0.1 s, and another one that comes meanwhile takes its place. What is no number pushes
    nobody.
    """

    def __init__(self, bus: Bus) -> None:
        self._events = bus.latest("event", OPERATOR)
        self._force, self._steps = 0.0, 0

    def step(self) -> float:
        """Force along the world's y on the trunk over the next policy step [N]."""
        sample = self._events.take()
        if sample is not None and sample.message.code == "push":
            self._force, self._steps = (
                _impulse(sample.message.detail) / (PUSH_STEPS * POLICY_DT),
                PUSH_STEPS,
            )
        if self._steps == 0:
            return 0.0
        self._steps -= 1
        return self._force


def _impulse(text: str) -> float:
    """An impulse that somebody has typed, at most `HARDEST_NS`; 0 where it is none."""
    try:
        impulse = float(text)
    except ValueError:
        return 0.0
    return 0.0 if math.isnan(impulse) else min(max(impulse, -HARDEST_NS), HARDEST_NS)
