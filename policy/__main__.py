"""The planner process: answers every robot state with a motion plan or with joint targets."""

import sys
from collections.abc import Callable

from saltus.loop.planner import compiled_observe
from saltus.policy.mover import FeetLines, Jumper, Mover
from saltus.policy.planner import jumping_grid, jumping_planner, make_planner, warm_up
from saltus.policy.process import PlannerProcess
from saltus.robots.legs import LegKinematics
from saltus.runtime.process import ProcessContext, run_process
from saltus.used_networks import walking_path
from saltus.wire.bus import Sample
from saltus.wire.messages import Done, DriveCommand, Heightmap, RobotState
from saltus.wire.topics import TOPICS, staleness_of

WAIT_S = 0.1
HEIGHTMAP_WAIT_S = 0.005  # real time: half a policy step for the heightmap of this state
STATE_WAIT_S = 0.01
"""Real time: a policy step. The heightmap of a state wakes the planner, which so wakes up once a
step; where no heightmap comes, it looks for states this often."""


class PlannerLoop:
    """Wires a planner to bus and clock; `movers` makes what moves a robot that is met anew."""

    def __init__(self, context: ProcessContext, movers: Callable[[], list[Mover]]) -> None:
        self._context = context
        self._lockstep = context.config.pace == "lockstep"
        self._movers = movers
        self._process = self._begun()
        self._robot: bytes | None = None
        self._states = context.bus.latest("controller/state", rings=self._lockstep)
        self._heightmaps = context.bus.latest("heightmap/heightmap")
        self._commands = context.bus.latest("operator/command", rings=self._lockstep)
        self._plans = {
            TOPICS[topic].message: context.bus.publisher(topic)
            for topic in context.config.plan_topics
        }
        self._done = context.bus.publisher("done", context.name)
        self._newest_step = self._commanded = -1  # of heightmaps and commands that have arrived
        self.ticks = 0

    def _begun(self) -> PlannerProcess:
        return PlannerProcess(self._context.setup.grid, *self._movers())

    def run(self) -> None:
        """Answers until the process is told to stop."""
        pending: Sample | None = None
        while not self._context.stopped:
            self._context.beat(ticks=self.ticks)
            sample = pending or self._next_state()
            pending = self._answer(sample) if sample is not None else None

    def _next_state(self) -> Sample | None:
        """A state that has come, or comes soon."""
        if self._lockstep:
            return self._states.wait(WAIT_S)
        bell = self._context.bus.bell
        heard, sample = bell.rings, self._states.take()
        if sample is None:
            bell.wait(heard, self._context.clock.machine_s(STATE_WAIT_S))
            sample = self._states.take()
        return sample

    def _answer(self, sample: Sample) -> Sample | None:
        """Answers one state.

        Returns a newer one that came while it waited for the heightmap of this one.
        """
        state: RobotState = sample.message
        if sample.envelope.boot_id != self._robot:  # another robot, or a restarted one
            self._robot = sample.envelope.boot_id
            self._process = self._begun()
            self._newest_step = self._commanded = -1
        if self._lockstep:
            self._context.clock.set(state.time_ns)
            heightmap, newer = self._heightmap_of(state)
            if newer is not None or self._context.stopped:
                return newer
        elif staleness_of(self._states.topic, state.time_ns, self._context.clock.now_ns()).usable:
            wait_s = 0.0 if self._newest_step >= state.step else HEIGHTMAP_WAIT_S
            heightmap = self._newest_heightmap(self._context.clock.machine_s(wait_s))
        else:
            return None
        command = self._command_of(state)
        if self._context.stopped:
            return None
        plan = self._process.step(state, heightmap, self._context.clock.now_ns(), command)
        self._plans[type(plan)].put(plan)
        if self._lockstep:
            self._done.put(Done(time_ns=state.time_ns, step=state.step, process=self._context.name))
        for notice in self._process.notices:
            self._context.event(notice.code, notice.detail)
        self._process.notices.clear()
        self.ticks += 1
        return None

    def _command_of(self, state: RobotState) -> DriveCommand | None:
        """The newest command; in lockstep that of this state,
        waited for, where the run has a script.
        """
        newest: DriveCommand | None = None
        waits = self._lockstep and self._context.config.commands is not None
        while True:
            sample = self._commands.wait(WAIT_S) if waits else self._commands.take()
            newest = newest if sample is None else sample.message
            self._commanded = self._commanded if newest is None else newest.step
            if not waits or self._commanded >= state.step or self._context.stopped:
                return newest
            self._context.beat(ticks=self.ticks)

    def _newest_heightmap(self, timeout_s: float) -> Heightmap | None:
        sample = self._heightmaps.wait(timeout_s) if timeout_s > 0.0 else self._heightmaps.take()
        if sample is None:
            return None
        heightmap: Heightmap = sample.message
        self._newest_step = heightmap.step
        return heightmap

    def _heightmap_of(self, state: RobotState) -> tuple[Heightmap | None, Sample | None]:
        """Lockstep: the heightmap of `state`, waited for.

        Or a newer state that ends the waiting.
        """
        heightmap = None
        while self._newest_step < state.step and not self._context.stopped:
            self._context.beat(ticks=self.ticks)
            found = self._newest_heightmap(WAIT_S)
            if found is not None:
                heightmap = found
                continue
            newer = self._states.take()
            if newer is not None and newer.message.step != state.step:
                return None, newer
        return heightmap, None


def body(context: ProcessContext) -> None:
    """Runs the process; see `saltus.runtime.process`."""
    loop = PlannerLoop(context, movers_of(context))
    context.ready()
    loop.run()


def movers_of(context: ProcessContext) -> Callable[[], list[Mover]]:
    """Makes movers of a run's planner, all loaded and warm; the errors of its models."""
    config, robot, grid = context.config, context.setup.robot, context.setup.grid
    if config.planner == "walking":
        jumps_on, planner = jumping_grid(robot), jumping_planner(robot)
    else:
        jumps_on = grid
        planner = make_planner(config.planner, robot, grid, config.policy_model)
    warm_up(planner, robot, jumps_on)
    # In lockstep nobody is late: the reference itself, to the bit
    compiled = None if config.pace == "lockstep" else compiled_observe(LegKinematics(robot))
    if config.planner != "walking":
        return lambda: [Jumper(robot, planner, compiled)]
    from saltus.policy.joints.policy import JointPolicy
    from saltus.policy.joints.walker import Walker

    policy = JointPolicy(walking_path(config.robot, config.policy_model))
    scan, lines = grid.places_of(policy.description.height_grid()), FeetLines(grid, jumps_on)
    return lambda: [Walker(robot, policy, scan), Jumper(robot, planner, compiled, lines)]


if __name__ == "__main__":
    sys.exit(run_process("policy", body))
