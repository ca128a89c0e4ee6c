"""A script of commands: a CSV file with a row for each change."""

import csv
import math
from bisect import bisect_right
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

from saltus.drive.goals import TURN_RPS, Goals, PoseOnWay
from saltus.drive.wish import STAND, Wish
from saltus.errors import ConfigError, check_known, nearest_hint
from saltus.wire.messages import CommandMode, RobotState
from saltus.wire.schemas import PLAN_VELOCITY, POSITION

VELOCITIES = ("ahead_mps", "left_mps", "turn_rps")
GOAL = ("x_m", "y_m")
COLUMNS = ("time_s", "mode", *VELOCITIES, *GOAL)
MODES = {mode.name.lower(): mode for mode in CommandMode}
RESTS = (CommandMode.STAND, CommandMode.LIE_DOWN)


class WishScript:
    """Wishes by time: each holds until the next one, and the robot stands before the first.

    A row with a place leads to it (`Goals`), at `ahead_mps` and turning at most by `turn_rps`, and
    has the robot stand there.

    Args:
        path: CSV file with the columns `COLUMNS`; velocities that are left out are 0. Times
            ascend, and the last row asks to stand or to lie down.

    Raises:
        ConfigError: it cannot be read; the message names file, row and value.
    """

    def __init__(self, path: Path) -> None:
        try:
            rows = _rows(path.read_text(encoding="utf-8-sig").splitlines())
        except OSError as error:
            raise ConfigError(f"cannot read {path}: {error.strerror}") from error
        except UnicodeDecodeError as error:
            raise ConfigError(f"{path}: it is not text in UTF-8 (save it as UTF-8)") from error
        except ConfigError as error:
            raise ConfigError(f"{path}: {error}") from error
        self._times = [time for time, _ in rows]
        self._wishes = [STAND, *(wish for _, wish in rows)]
        self._way = PoseOnWay()

    @property
    def end_s(self) -> float:
        """Time of the last row."""
        return self._times[-1]

    def wish(self, time_s: float, state: RobotState) -> Wish:
        """The wish at a time since the start and a state; states come in order, none twice."""
        seen = self._way.step(state)
        wish = self._wishes[bisect_right(self._times, time_s)]
        return wish.lead(*seen) if isinstance(wish, Goals) else wish


def _rows(lines: Iterable[str]) -> list[tuple[float, Wish | Goals]]:
    reader = csv.DictReader(lines, skipinitialspace=True)
    names = reader.fieldnames or []
    for name in names:
        check_known("no column", name, COLUMNS)
    if not {"time_s", "mode"} <= set(names):
        raise ConfigError(f"the first line must name the columns, {','.join(COLUMNS)}")
    rows = [_row(number, row) for number, row in enumerate(reader, start=2)]
    for number, ((before, _), (after, _)) in enumerate(pairwise(rows), start=3):
        if not before < after:
            raise ConfigError(f"line {number}: time_s = {after:g}: times must ascend")
    last = rows[-1][1] if rows else None
    if not isinstance(last, Wish) or last.mode not in RESTS:
        raise ConfigError(
            "the last row must ask to stand or to lie_down: what follows it is unsaid"
        )
    return rows


def _row(number: int, row: dict[str, str | None]) -> tuple[float, Wish | Goals]:
    mode = (row["mode"] or "").strip()
    if mode not in MODES:
        raise ConfigError(f"line {number}: no mode '{mode}': {nearest_hint(mode, MODES)}")
    time_s = _number(number, row, "time_s", math.inf)
    ahead, left, turn = (_number(number, row, name) for name in VELOCITIES)
    if not any((row.get(name) or "").strip() for name in GOAL):
        return time_s, Wish(mode=MODES[mode], ahead_mps=ahead, left_mps=left, turn_rps=turn)
    if MODES[mode] != CommandMode.WALK or not ahead > 0.0 or left != 0.0 or turn < 0.0:
        raise ConfigError(
            f"line {number}: a row with x_m or y_m walks there: give mode walk, ahead_mps above 0 "
            "and no left_mps; turn_rps is the fastest turning"
        )
    x, y = (_number(number, row, name, POSITION) for name in GOAL)
    return time_s, Goals([(x, y)], ahead, turn or TURN_RPS)


def _number(line: int, row: dict[str, str | None], name: str, most: float = PLAN_VELOCITY) -> float:
    text = (row.get(name) or "0").strip()
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= most or math.isinf(value):
        raise ConfigError(f"line {line}: {name} = {text}: it must be a number, at most {most:g}")
    return value
