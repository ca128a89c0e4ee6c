"""Entry point of the operator's process: it answers each robot state with a command."""

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from saltus.drive import gamepad
from saltus.drive.goals import TURN_RPS, Goals
from saltus.drive.keyboard import unbuffered_keys
from saltus.drive.script import WishScript
from saltus.drive.wish import Wish
from saltus.errors import ConfigError
from saltus.runtime.process import ProcessContext, run_process
from saltus.wire.messages import RobotState

WAIT_S = 0.1
AFTER_S = 1.0
"""A script or goals of `saltus drive` end so long after their last wish, which has then been
heard."""
SPEED_MPS = 0.6
"""Between goals: well within what policies are trained for."""

WishSource = Callable[[RobotState], Wish | None]
"""Says what is wished at a state, None at the end."""


def body(context: ProcessContext, driver: WishSource | None = None) -> None:
    """Answers until the driver or the run is over; by the run's own script where there is none."""
    drive = driver or of_run(context)
    states = context.bus.latest("controller/state")
    commands = context.bus.publisher("operator/command")
    context.ready()
    ticks = 0
    while not context.stopped:
        context.beat(ticks=ticks)
        sample = states.wait(WAIT_S)
        if sample is None:
            continue
        state: RobotState = sample.message
        if context.clock.lockstep:
            context.clock.set(state.time_ns)
        wish = drive(state)
        if wish is None:
            return
        commands.put(wish.at(state))
        ticks += 1


def of_run(context: ProcessContext) -> WishSource:
    """The script of a run, by the time of the run; it never ends, as others wait for it."""
    path = context.config.commands
    if path is None:
        raise ConfigError(
            "the run has no script of commands: give --script, --goals, --keys or --gamepad"
        )
    script = WishScript(Path(path))
    return lambda state: script.wish(1e-9 * state.time_ns, state)


def by_script(path: Path) -> WishSource:
    """A script from the first state on, and a second more."""
    script, first = WishScript(path), list[int]()

    def drive(state: RobotState) -> Wish | None:
        first.append(state.time_ns) if not first else None
        time_s = 1e-9 * (state.time_ns - first[0])
        return None if time_s > script.end_s + AFTER_S else script.wish(time_s, state)

    return drive


def by_goals(goals: Goals) -> WishSource:
    """Goals, and a second more."""
    over = list[int]()

    def drive(state: RobotState) -> Wish | None:
        wish = goals.wish(state)
        if goals.is_over:
            over.append(state.time_ns) if not over else None
        return None if over and state.time_ns - over[0] > 1e9 * AFTER_S else wish

    return drive


def _goal(text: str) -> tuple[float, float]:
    x, y = (float(part) for part in text.split(","))
    return x, y


def _driver_of(own: argparse.Namespace) -> WishSource | None:
    if own.script is not None:
        return by_script(own.script)
    if own.goals:
        return by_goals(Goals(own.goals, own.speed_mps, own.turn_rps))
    return None


def main(arguments: Sequence[str] | None = None) -> int:
    """Reads what this process has beyond every process's arguments, and runs it."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--script", type=Path)
    parser.add_argument("--goals", nargs="+", type=_goal, default=[])
    parser.add_argument("--keys", action="store_true")
    parser.add_argument("--gamepad", type=Path)
    parser.add_argument("--speed-mps", type=float, default=SPEED_MPS)
    parser.add_argument("--turn-rps", type=float, default=TURN_RPS)
    own, others = parser.parse_known_args(arguments)
    return run_process("operator", partial(_run, own=own), others)


def _run(context: ProcessContext, own: argparse.Namespace) -> None:
    if own.keys:
        with unbuffered_keys(sys.stdin.fileno()) as keys:
            body(context, lambda _: keys.wish())
    elif own.gamepad is not None:
        with gamepad.open_gamepad(own.gamepad) as pad:
            sys.stderr.write(f"{gamepad.HELP}\n")
            body(context, lambda _: pad.wish())
    else:
        body(context, _driver_of(own))


if __name__ == "__main__":
    sys.exit(main())
