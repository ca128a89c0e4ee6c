"""The planner process: answers every robot state with a motion plan."""

import sys
from math import inf

from policy.planning import Planning
from saltus.bus import Sample
from saltus.messages import Done, Heightmap, MotionPlan, RobotState
from saltus.process import ProcessContext, run_process
from saltus.ticker import freshness

WAIT_S = 0.1
HEIGHTMAP_WAIT_S = 0.005
"""Real time: how long a state waits for its heightmap; the service takes 1 ms, and half the period is left."""


class PlannerProcess:
    """Wires the planning to bus and clock."""

    def __init__(self, context: ProcessContext) -> None:
        self._context = context
        self._lockstep = context.config.pace == "lockstep"
        self._planning = Planning()
        self._states = context.bus.latest("controller/state")
        self._heightmaps = context.bus.latest("heightmap/heightmap")
        self._plans = context.bus.publisher("policy/plan")
        self._done = context.bus.publisher("done", context.name)
        self._heightmap: Heightmap | None = None
        self._arrival_ns = 0
        self._answer: MotionPlan | None = None
        self.ticks = 0

    def run(self) -> None:
        """Answers until the process is told to stop."""
        pending: Sample | None = None
        while not self._context.stopped:
            self._context.beat(ticks=self.ticks)
            sample = pending or self._states.wait(WAIT_S)
            pending = self._answer_state(sample.message) if sample is not None else None

    def _answer_state(self, state: RobotState) -> Sample | None:
        """Answers one state; returns a newer one that came while it waited for the heightmap of this one."""
        if self._answer is None or self._answer.step != state.step:
            if self._lockstep:
                self._context.clock.set(state.time_ns)
                newer = self._wait_in_lockstep(state)
                if newer is not None or self._context.stopped:
                    return newer
            elif freshness(self._states.topic, state.time_ns, self._context.clock.now_ns()).usable:
                self._wait_in_real_time(state)
            else:
                return None
            self._answer = self._plan(state)
            self.ticks += 1
        self._plans.put(self._answer)
        self._done.put(Done(time_ns=state.time_ns, step=state.step, process=self._context.name))
        return None

    def _plan(self, state: RobotState) -> MotionPlan:
        before = self._planning.memory.stopped
        now_ns = self._context.clock.now_ns()
        silent_s = 1e-9 * (now_ns - self._arrival_ns) if self._heightmap is not None else inf
        plan = self._planning.step(state, self._heightmap, silent_s)
        if self._planning.memory.stopped != before:
            self._context.event(self._planning.memory.stopped, f"step {state.step}: the robot is asked to stop")
        return plan

    def _wait_in_lockstep(self, state: RobotState) -> Sample | None:
        """Waits until the heightmap of `state` is there; a newer state ends the waiting and is returned."""
        while not self._has(state) and not self._context.stopped:
            self._context.beat(ticks=self.ticks)
            self._keep(self._heightmaps.wait(WAIT_S))
            newer = self._states.take()
            if newer is not None and newer.message.step != state.step and not self._has(state):
                return newer
        return None

    def _wait_in_real_time(self, state: RobotState) -> None:
        self._keep(self._heightmaps.take())
        if not self._has(state):
            self._keep(self._heightmaps.wait(HEIGHTMAP_WAIT_S))

    def _has(self, state: RobotState) -> bool:
        return self._heightmap is not None and self._heightmap.step >= state.step

    def _keep(self, sample: Sample | None) -> None:
        if sample is not None:
            self._heightmap = sample.message
            self._arrival_ns = self._context.clock.now_ns()


def body(context: ProcessContext) -> None:
    """Runs the process; see `saltus.process`."""
    process = PlannerProcess(context)
    context.ready()
    process.run()


if __name__ == "__main__":
    sys.exit(run_process("policy", body))
