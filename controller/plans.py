"""The newest plan and its age, and the event that is sent when plans stop coming."""

from dataclasses import replace

from saltus.controller.watchdog import WatchdogConfig
from saltus.runtime.process import ProcessContext
from saltus.wire.messages import AnyPlan, PlanStatus


class Plans:
    """The planner's newest plan: of joint targets where the run's planner walks."""

    def __init__(self, context: ProcessContext) -> None:
        self._context = context
        self._lost_age_s = WatchdogConfig().lost_age_s
        self._slot = context.bus.latest(context.config.plan_topic)
        self._plan: AnyPlan | None = None
        self._standing: AnyPlan | None = None
        self._lost = False

    def take(self) -> AnyPlan | None:
        """The newest plan, if one has arrived since the last call."""
        sample = self._slot.take()
        return None if sample is None else self._keep(sample.message)

    def wait(self, timeout_s: float) -> AnyPlan | None:
        """The next plan, at most `timeout_s` from now."""
        sample = self._slot.wait(timeout_s)
        return None if sample is None else self._keep(sample.message)

    def newest(self, now_ns: int, *, halt: bool) -> tuple[AnyPlan | None, float]:
        """The newest plan and its age [s]; infinite before the first.

        `halt` is for a run that is over for the robot: its plan says STAND and is never late.
        """
        self.take()
        age_s = self._age_s(now_ns)
        lost = self._plan is not None and age_s > self._lost_age_s
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

    def _keep(self, plan: AnyPlan) -> AnyPlan:
        self._plan = plan
        return plan

    def _age_s(self, now_ns: int) -> float:
        return float("inf") if self._plan is None else 1e-9 * (now_ns - self._plan.time_ns)
