"""Lockstep from the side of the plant: one policy step is over when camera,
heightmap and planner have answered.
"""

import time
from collections.abc import Callable

from saltus.controller.newest_plan import NewestPlan
from saltus.errors import StackError
from saltus.runtime.process import ProcessContext
from saltus.wire.bus import Publisher
from saltus.wire.messages import GroundTruth, RobotState

RESEND_S = 0.5
SILENCE_LIMIT_S = 20.0
"""Longer than a stranger who subscribes and then stands still holds up a run: 8 to 10 s
(zenoh_cfg/README.md)."""
POLL_S = 0.1  # how often a wait looks whether the process should stop


class Lockstep:
    """The controller's side of a run in lockstep: it asks the other processes in each policy step
    and waits for their answers; all of them may be asked twice. It puts `plant/truth` and
    `controller/state` by the publishers of the whole run, so that a landing counts them on.
    """

    def __init__(
        self, context: ProcessContext, plans: NewestPlan, truths: Publisher, states: Publisher
    ) -> None:
        self._context = context
        self._plans = plans
        self._truths = truths
        self._states = states
        self._render = context.bus.latest("done", "render")
        self._heightmap = context.bus.latest("done", "heightmap")
        self._heightmap_step = -1
        self._depth_due = -1

    def answered(self, truth: GroundTruth, state: Callable[[int, int, int], RobotState]) -> bool:
        """Takes one policy step through camera, heightmap and planner;
        False if the process is to stop.

        `state` makes the robot state from time, step and the newest camera frame that is due. The
        plan is then in `NewestPlan`.

        Raises:
            StackError: one of them has not answered for `SILENCE_LIMIT_S`.
        """
        step = truth.step
        if not self._ask(
            lambda _: self._truths.put(truth), lambda wait_s: self._rendered(step, wait_s), step
        ):
            return False
        message = state(truth.time_ns, step, self._depth_due)

        def ask(again: bool) -> None:
            if again:  # the image that is due may not have come: the camera sends it once more
                self._truths.put(truth)
            self._states.put(message)

        return self._ask(ask, lambda wait_s: self._planned(step, wait_s), step)

    def _ask(self, send: Callable[[bool], None], answer: Callable[[float], str], step: int) -> bool:
        """Sends until all have answered; `answer` names a process that has not,
        `send` is told whether it is again.
        """
        looked = sent = time.monotonic()
        silent_s = 0.0
        send(False)
        while (silent := answer(POLL_S)) and not self._context.stopped:
            now = time.monotonic()
            silent_s += min(now - looked, 2.0 * POLL_S)  # who stood still itself could hear nobody
            looked = now
            if silent_s > SILENCE_LIMIT_S:
                raise StackError(
                    f"process '{silent}' has not answered step {step} for {SILENCE_LIMIT_S:.0f} s: "
                    "see its log"
                )
            if now - sent > RESEND_S:
                send(True)
                sent = now
            self._context.beat(ticks=step)
        return not self._context.stopped

    def _rendered(self, step: int, wait_s: float) -> str:
        sample = self._render.wait(wait_s)
        if sample is None or sample.message.step != step:
            return "render"
        self._depth_due = sample.message.frame_id
        return ""

    def _planned(self, step: int, wait_s: float) -> str:
        plan = self._plans.wait(wait_s)
        if plan is not None and plan.step == step:
            return ""
        done = self._heightmap.take()
        if done is not None:
            self._heightmap_step = done.message.step
        return "policy" if self._heightmap_step >= step else "heightmap"
