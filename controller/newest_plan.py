"""The newest plan and its age, and the event that is sent when plans stop coming."""

from dataclasses import replace

from saltus.controller.watchdog import LOST_AGE_S
from saltus.runtime.process import ProcessContext
from saltus.wire.messages import AnyPlan, PlanStatus


class NewestPlan:
    """The planner's newest plan: of joint targets while it walks, else of jumps."""

    def __init__(self, context: ProcessContext) -> None:
        self._context = context
        self._bell, self._heard = context.bus.bell, -1
        self._slots = [context.bus.latest(topic) for topic in context.config.plan_topics]
        self._plan: AnyPlan | None = None
        self._standing: AnyPlan | None = None
        self._lost = False

    def take(self) -> AnyPlan | None:
        """The newest plan, if one has arrived since the last call."""
        if self._heard == self._bell.rings:  # as in four ticks of five
            return None
        self._heard = self._bell.rings
        taken = [sample.message for slot in self._slots if (sample := slot.take()) is not None]
        if not taken:
            return None
        self._plan = max(taken, key=lambda plan: plan.time_ns)
        return self._plan

    def wait(self, timeout_s: float) -> AnyPlan | None:
        """The next plan, at most `timeout_s` from now."""
        return self._context.bus.bell.wait_for(self.take, timeout_s)

    def newest(self, now_ns: int, *, halt: bool) -> tuple[AnyPlan | None, float]:
        """The newest plan and its age [s]; infinite before the first.

        `halt` is for a run that is over for the robot: its plan says STAND and is never late.
        """
        self.take()
        age_s = self._age_s(now_ns)
        lost = self._plan is not None and age_s > LOST_AGE_S
        if lost != self._lost:
            self._lost = lost
            self._context.event(
                "plan_lost" if lost else "plan_back", f"the newest plan is {1e3 * age_s:.0f} ms old"
            )
        if halt and self._plan is not None:
            self._standing = self._standing or replace(self._plan, status=PlanStatus.STAND)
            return self._standing, 0.0
        return self._plan, age_s

    def reason(self, now_ns: int) -> str:
        """Why the mode may just have changed, for people."""
        if self._plan is None:
            return "no plan yet"
        detail = f": {self._plan.reason}" if self._plan.reason else ""
        return f"plan {self._plan.status.name}, {1e3 * self._age_s(now_ns):.0f} ms old{detail}"

    def _age_s(self, now_ns: int) -> float:
        return float("inf") if self._plan is None else 1e-9 * (now_ns - self._plan.time_ns)
