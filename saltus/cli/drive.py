"""`saltus drive`: commands a robot of a run, by a script, to goals, by keys or a gamepad."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from saltus.cli.serve import serve_module
from saltus.errors import ConfigError
from saltus.flags import EndpointOption, Flag, flag_help


@dataclass(frozen=True, kw_only=True)
class Drive(EndpointOption):
    """Commands the robot of a running stack: stand, walk, jump, lie down. It stands when this ends.

    A script is a CSV file with the columns time_s, mode, ahead_mps, left_mps, turn_rps, x_m, y_m;
    each row holds until the next one, and one with x_m and y_m leads to that place.

    For example:
      saltus drive --run-dir runs/one --script round.csv
      saltus drive --run-dir runs/one --goals 3,0 3,2 0,2 --speed-mps 0.8
      saltus drive --run-dir runs/one --keys
      saltus drive --run-dir runs/one --gamepad /dev/input/js0
    """

    run_dir: Path
    """Folder of the run: of `saltus up` or `saltus router`."""
    script: Annotated[Path | None, flag_help("PATH", "none")] = None
    """Commands by the time since this began."""
    goals: Annotated[tuple[str, ...], flag_help("X,Y", "none")] = ()
    """Places to walk to, ahead of the robot and to its left as it stands now [m], by its own
    odometry. One behind it needs a space before its sign: " -1,0"."""
    keys: Flag = False
    """Drive by the keys of this terminal: w s ahead and back, a d turn, q e aside, space stand, j
    jump, l lie down."""
    gamepad: Annotated[Path | None, flag_help("PATH", "none")] = None
    """Drive by a gamepad, e.g. /dev/input/js0: left stick ahead, back and aside, right stick turn, A
    stand, B jump, Y lie down. The robot stands where the gamepad is gone."""
    speed_mps: float = 0.6
    """Speed between goals."""
    turn_rps: float = 0.8
    """Fastest turning on the way to goals."""

    def run(self) -> int:
        """Runs until the script or the run is over, or all goals are reached."""
        asked = [self.script is not None, bool(self.goals), self.keys, self.gamepad is not None]
        if asked.count(True) != 1:
            raise ConfigError(
                "give one of --script FILE.csv, --goals X,Y ..., --keys and --gamepad DEVICE"
            )
        if self.keys:
            if not sys.stdin.isatty():
                raise ConfigError("--keys needs a terminal: give --script FILE.csv")
            more = ["--keys"]
        elif self.gamepad is not None:
            from saltus.drive.gamepad import open_gamepad

            with open_gamepad(self.gamepad):
                more = ["--gamepad", str(self.gamepad)]
        elif self.script is not None:
            from saltus.drive.script import WishScript

            WishScript(self.script)
            more = ["--script", str(self.script)]
        else:
            for goal in self.goals:
                _check_goal(goal)
            speeds = ["--speed-mps", str(self.speed_mps), "--turn-rps", str(self.turn_rps)]
            # With a space before it a goal that begins with a minus is not taken for a flag
            more = [*speeds, "--goals", *(f" {goal}" for goal in self.goals)]
        return serve_module("saltus.drive", self.run_dir, self.endpoint, *more, peer=False)


def _check_goal(text: str) -> None:
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        x = y = float("nan")
    if not (abs(x) < 1e3 and abs(y) < 1e3):
        raise ConfigError(f"--goals {text}: a goal is X,Y [m], e.g. 3,0.5")
