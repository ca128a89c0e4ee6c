"""Where results go and how they are printed."""

import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from saltus.flags import Flag
from saltus.folders import ask_for_room, new_folder

if TYPE_CHECKING:
    from tqdm import tqdm

    from saltus.runtime.stack import Stack

PROGRESS_PERIOD_S = 0.2


def run_directory(command: str, out: Path | None) -> Path:
    """The folder of this run: `out`, or a new `runs/<date>-<command>`. It is made here.

    Raises:
        SaltusError: it cannot be written into.
    """
    path = out or new_folder(command)
    ask_for_room(path)
    return path


def poll_until_done(stack: "Stack") -> Iterator[None]:
    """Yields five times a second until the run is over.

    Says on stderr, once, that the computer does not keep up.
    """
    from tqdm import tqdm

    told = False
    while not stack.wait(PROGRESS_PERIOD_S * stack.config.speed):
        if stack.too_slow is not None and not told:
            tqdm.write(f"saltus: {stack.too_slow}", file=sys.stderr)
            told = True
        yield


@dataclass(frozen=True, kw_only=True)
class JsonOption:
    """Flag of a command that measures."""

    json: Flag = False
    """Print the result as one JSON object on the last line."""

    def tell_json(self, table: Mapping[str, object]) -> None:
        """Prints the result where that is asked for."""
        if self.json:
            print_json(table)


class Bar:
    """A progress bar whose text is the stage."""

    def __init__(self) -> None:
        self._bar: tqdm[None] | None = None

    def __enter__(self) -> "Bar":
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def say(self, line: str) -> None:
        """Prints a line in place of the bar; the next stage brings another."""
        self.__exit__()
        self._bar = None
        print(line, flush=True)

    def at(self, stage: str, share: float) -> None:
        """Shows a stage and the share that is done; the bar comes with the first."""
        from tqdm import tqdm

        if self._bar is None:
            shape = "{desc:24} {percentage:3.0f} % |{bar:30}| {elapsed}"
            self._bar = tqdm(total=1.0, file=sys.stderr, bar_format=shape)
        self._bar.set_description_str(stage, refresh=False)
        self._bar.update(min(share, 1.0) - self._bar.n)


def print_json(table: Mapping[str, object]) -> None:
    """Prints one JSON object on one line; numbers that are not finite become null."""
    print(json.dumps(without_infinities(table)), flush=True)


def print_figures(figures: Mapping[str, object], indent: str = "") -> None:
    """Prints figures for people: one a line,
    and a table where several rows have figures of the same names.
    """
    width = max(map(len, figures), default=0)
    for name, value in figures.items():
        rows = _rows(value)
        if rows:
            print(f"{indent}{name}:", *table_lines(rows), sep=f"\n{indent}  ")
        elif isinstance(value, dict) and any(
            isinstance(part, dict) or _rows(part) for part in value.values()
        ):
            print(f"{indent}{name}:")
            print_figures(value, indent + "  ")
        else:
            print(f"{indent}{name:{width}}  {_cell(value)}")


def without_infinities(value: object) -> Any:
    """`value` with NaN and infinities replaced by None, which JSON can say."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: without_infinities(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_infinities(item) for item in value]
    return value


def _rows(value: object) -> list[tuple[str, dict[str, Any]]]:
    """Labels and rows of a table; nothing where a value is no table."""
    if isinstance(value, list | tuple):
        rows: list[tuple[str, Any]] = [("", row) for row in value]
    else:
        rows = list(value.items()) if isinstance(value, dict) else []
    return (
        rows
        if all(isinstance(row, dict) and all(map(_is_cell, row.values())) for _, row in rows)
        else []
    )


def _is_cell(value: object) -> bool:
    """True where it is short enough for a table; counts by name are."""
    return not isinstance(value, dict) or all(isinstance(part, int) for part in value.values())


def table_lines(rows: Sequence[tuple[str, Mapping[str, object]]]) -> Iterator[str]:
    """Lines of a table for people: rows with their labels, and their cells by column."""
    columns = list(dict.fromkeys(name for _, row in rows for name in row))
    cells = [
        ["", *columns],
        *([label, *(_cell(row.get(name)) for name in columns)] for label, row in rows),
    ]
    label, *widths = (max(map(len, column)) for column in zip(*cells, strict=True))
    for line in cells:
        yield "  ".join([line[0].ljust(label), *map(str.rjust, line[1:], widths)]).rstrip()


def _cell(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {_cell(part)}" for name, part in value.items()) or "-"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_cell, value))}]"
    if isinstance(value, float):
        return f"{value:.4g}" if math.isfinite(value) else "-"
    return "-" if value is None else str(value)
