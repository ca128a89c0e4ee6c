"""The controller process: the leg controller and the robot behind it, wired to the bus."""

import json
import sys
from dataclasses import asdict

from saltus.constants import PHYSICS_DT, POLICY_STEPS
from saltus.controller.compensation import compensation_for
from saltus.controller.control_loop import ControlLoop
from saltus.controller.course_run import AT_REST, CourseRun, CourseState
from saltus.controller.lockstep import Lockstep
from saltus.controller.newest_plan import NewestPlan
from saltus.controller.robot.backend import CourseRobot
from saltus.controller.robot.mujoco import MujocoRobot
from saltus.controller.shove import TrunkShove
from saltus.controller.tick import CompiledTickLaw, TickLaw
from saltus.runtime.process import ProcessContext, run_process
from saltus.runtime.ticker import Ticker
from saltus.tuning import freeze_garbage_collector
from saltus.wire.messages import ControllerMode

TICK_NS = round(1e9 * PHYSICS_DT)
STEP_NS = TICK_NS * POLICY_STEPS
CATCH_UP_TICKS = 10
"""20 ms: a robot that is simulated here should not fall behind the run's clock when the machine
stalls."""
STEPS_AT_REST = 120
"""The end of a recording shows a robot that stands: of 80 landings on flat ground at random phases
of the gait, the slowest was at rest 0.98 s after its legs had caught it."""
MAX_STEPS_TO_STAND = 250
"""2.5 s: a landing takes 1.1 s at most, and the supervisor kills what has not ended 3 s after it
was told to."""


def body(context: ProcessContext) -> None:
    """Runs one trial, to its end or until the process is told to stop."""
    robot = _robot(context)
    try:
        robot.reset()
        ControllerRun(context, robot).run()
    finally:
        robot.close()


def _robot(context: ProcessContext) -> CourseRobot:
    """The robot of a run: simulated here, or over DDS in another process."""
    if context.config.link == "dds":
        from saltus.controller.robot.unitree.on_course import UnitreeOnCourse  # needs Cyclone DDS

        return UnitreeOnCourse.of_run(context.setup, context.config, context.clock)
    # In lockstep nobody is late: the reference itself, to the bit
    return MujocoRobot(context.setup, compiled=context.config.pace == "realtime")


class ControllerRun:
    """One run of the controller process: it steps leg controller and robot, and talks on a bus."""

    def __init__(self, context: ProcessContext, robot: CourseRobot) -> None:
        self._context = context
        self._robot = robot
        kind = context.setup.robot
        compensation = compensation_for(context.config.known, kind)
        # Nobody is late there: the reference itself, to the bit
        lockstep = context.config.pace == "lockstep"
        tick = (TickLaw if lockstep else CompiledTickLaw)(kind, compensation)
        # One that is simulated here begins in its stand pose
        self._loop = ControlLoop(kind, tick, rises=context.config.link == "dds")
        self._course = CourseRun(context.setup.terrain, context.config.time_limit_s)
        self._progress = CourseState(outcome=None, halt=False, over=False)
        self._plans = NewestPlan(context)
        self._shove = TrunkShove(context.bus)
        self._joints = context.bus.publisher("controller/joints")
        self._states = context.bus.publisher("controller/state")
        self._truths = context.bus.publisher("plant/truth")
        self._mode = ControllerMode.STAND
        self._step = 0
        self._interrupted = False
        self._steps_lost = 0

    def run(self) -> None:
        """Steps to the end: in lockstep when all others have answered,
        in real time by the run's clock.
        """
        exchange = ticker = None
        if self._context.config.pace == "lockstep":
            exchange = Lockstep(self._context, self._plans, self._truths, self._states)
        else:
            here = self._context.config.link == "here"
            catch_up = CATCH_UP_TICKS if here else 1
            ticker = Ticker(1.0 / PHYSICS_DT, catch_up=catch_up, clock=self._context.clock)
            freeze_garbage_collector()
        self._context.ready()
        while not self._finished():
            self._context.beat(
                ticks=self._step * POLICY_STEPS, overruns=0 if ticker is None else ticker.overruns
            )
            if not self._policy_step(ticker, exchange):
                break
        self._come_to_a_stand(ticker)

    def _policy_step(self, ticker: Ticker | None, exchange: Lockstep | None = None) -> bool:
        """Ten milliseconds: by the run's clock, or, without a ticker, as fast as it goes.

        Without an exchange it waits for nobody. False where the process is told to stop while it
        waits.
        """
        start_ns = self._step * STEP_NS
        for tick in range(POLICY_STEPS):
            if ticker is None:
                now_ns = self._step * STEP_NS + tick * TICK_NS
                self._context.clock.set(now_ns)
            else:
                ticker.wait()
                now_ns = self._context.clock.now_ns()
            self._loop.sense(self._robot.read())
            if tick == 0:
                start_ns = now_ns
                truth = self._robot.truth(now_ns, self._step)
                if exchange is None:
                    self._truths.put(truth)
                    self._states.put(self._loop.state(now_ns, self._step))
                elif not exchange.answered(truth, self._loop.state):
                    return False
                self._robot.push(self._shove.step())
            self._act(now_ns)
        self._close_step(start_ns)
        return True

    def _come_to_a_stand(self, ticker: Ticker | None) -> None:
        """A robot that is told to stop in the middle of a run lands before its controller goes."""
        if not (self._progress.over or self._robot.fault):
            self._interrupted = True
            resting = 0
            for _ in range(MAX_STEPS_TO_STAND):
                self._policy_step(ticker)
                resting += self._mode in AT_REST
                if resting >= STEPS_AT_REST:
                    break

    @property
    def _doubt(self) -> str:
        """Reason to give the robot up, damped or landing; empty while there is none."""
        return self._robot.fault or self._robot.concern

    def _finished(self) -> bool:
        lost = self._steps_lost >= STEPS_AT_REST
        return self._context.stopped or self._progress.over or lost

    def _act(self, now_ns: int) -> None:
        doubt = self._doubt
        halt = self._progress.halt or self._interrupted or bool(doubt)
        plan, age_s = self._plans.newest(now_ns, halt=halt)
        self._robot.write(self._loop.act(plan, age_s))
        if self._loop.mode != self._mode:
            self._mode = self._loop.mode
            reason = doubt or ("the run is over" if halt else self._plans.reason(now_ns))
            self._context.event(f"mode_{self._mode.name.lower()}", reason)

    def _close_step(self, start_ns: int) -> None:
        self._joints.put(self._loop.take_joint_log(start_ns, self._step))
        self._step += 1
        if doubt := self._doubt:
            if not self._steps_lost:
                self._context.event("robot_lost", doubt)
            self._steps_lost += 1
        before = self._progress
        self._progress = self._course.step(
            self._step * POLICY_STEPS * PHYSICS_DT,
            *self._robot.pose(),
            self._robot.take_trunk_contact(),
            self._mode,
        )
        outcome = self._progress.outcome
        if outcome is not None and before.outcome is None:
            code = {"": "finished", "time_limit": "timeout"}.get(outcome.cause, "fell")
            self._context.event(code, json.dumps(asdict(outcome)))


if __name__ == "__main__":
    sys.exit(run_process("controller", body))
