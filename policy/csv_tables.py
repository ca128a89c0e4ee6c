"""Tables that a training writes row by row, and a resumed training continues: CSV with a header."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

from saltus.errors import SaltusError
from saltus.files import atomic_write

MISSING = "nan"
"""In columns for which a row has no value: a resumed training may have other terrains."""


def read_csv_table(path: Path) -> list[dict[str, str]]:
    """The rows of a table; none where there is no table."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def append_table(path: Path, rows: Sequence[Mapping[str, object]]) -> None:
    """Adds rows, and a header where the table begins; columns that are new go behind the others.

    Raises:
        SaltusError: the table cannot be written.
    """
    before = read_csv_table(path)
    known = list(before[0]) if before else []
    if not set(rows[0]) <= set(known):
        _write(path, [*before, *rows])
        return
    try:
        with path.open("a", newline="", encoding="utf-8") as file:
            csv.DictWriter(file, known, restval=MISSING).writerows(rows)
    except OSError as error:
        raise SaltusError(f"cannot write {path}: {error.strerror}") from error


def carry_on(source: Path, target: Path, iteration: int) -> None:
    """Begins a table with the rows of another one until `iteration`.

    Without that one, nothing is written.

    Rows after the resumed checkpoint are left out: those iterations are trained again.

    Raises:
        SaltusError: the table cannot be written.
    """
    rows = read_csv_table(source)
    kept = [row for row in rows if float(row["iteration"]) <= iteration]
    if kept and (source != target or len(kept) < len(rows)):
        _write(target, kept)


def _write(path: Path, rows: Sequence[Mapping[str, object]]) -> None:
    """Writes a whole table, whole or not at all."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    try:
        with atomic_write(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, names, restval=MISSING)
            writer.writeheader()
            writer.writerows(rows)
    except OSError as error:
        raise SaltusError(f"cannot write {path}: {error.strerror}") from error
