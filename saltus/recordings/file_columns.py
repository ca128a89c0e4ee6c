"""Columns of numbers as people keep them: text with any separator and decimal sign,
Parquet, archives of numpy.
"""

import codecs
import contextlib
import csv
import io
import re
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from saltus.arrays import Floats
from saltus.errors import RecordingError, nearest_hint
from saltus.files import check_archive

HEAD_BYTES = 2**18  # of a text, in which its names and first rows stand
BYTE_ORDER_MARKS = {b"\xef\xbb\xbf": "utf-8", b"\xff\xfe": "utf-16-le", b"\xfe\xff": "utf-16-be"}
SEPARATORS = (";", "\t", "|", ",", " ")
"""The first that cuts the names and the first row into equally many parts. A comma comes late: it
may be the decimal sign. A space stands for any number of spaces."""
COMMENT = ("#", "%", "//")
DECIMAL_SIGNS = (".", ",")
UNEVEN = re.compile(r"(?:Row #(\d+): )?Expected (\d+) columns, got (\d+)")  # as Arrow says it
NUMBER = re.compile(
    r"\s*[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?\s*|\s*[-+]?(nan|inf)\s*|\s*", re.IGNORECASE
)


@dataclass(frozen=True, kw_only=True)
class FileColumns:
    """Columns of a table or archive of a stranger's log by their names, shape (rows,) each, or
    (rows, joints) of an archive.
    """

    values: dict[str, Floats]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class _Form:
    """How a text is written."""

    names: list[str]
    separator: str
    encoding: str
    skipped: int
    """Lines before the first row."""


def read_text(path: Path, wanted: Sequence[str] | None = None) -> FileColumns:
    """Columns of a text (CSV), whatever its separator,
    decimal sign and encoding, also with comments before the names.

    Args:
        path: Any file.
        wanted: Names of columns; all that have one by default.

    Raises:
        RecordingError: it cannot be read, lacks a column, names one twice, has no rows, or a column
            holds text.
    """
    try:
        form = _form(path)
        places = _places(form.names, wanted)
        table, notes = _parsed(path, form, list(places.values()))
        values = {name: table[str(place)].to_numpy() for name, place in places.items()}
    except (OSError, ValueError, csv.Error, pa.ArrowException) as error:
        raise RecordingError(f"cannot read {path}: {str(error).splitlines()[0]}") from error
    if not table.num_rows:
        raise RecordingError(f"{path} has no rows")
    return FileColumns(values=values, notes=notes)


def read_parquet(path: Path, wanted: Sequence[str] | None = None) -> FileColumns:
    """Columns of a Parquet file.

    Raises:
        RecordingError: it cannot be read, lacks a column, names one twice, has no rows, or a column
            holds text.
    """
    try:
        table = pyarrow.parquet.read_table(path)
        places = _places([name.strip() for name in table.column_names], wanted)
        values = {
            name: table.column(place).cast(pa.float64()).to_numpy()
            for name, place in places.items()
        }
    except (OSError, ValueError, pa.ArrowException) as error:
        raise RecordingError(f"cannot read {path}: {str(error).splitlines()[0]}") from error
    if not table.num_rows:
        raise RecordingError(f"{path} has no rows")
    return FileColumns(values=values)


def names_in_archive(path: Path) -> list[str]:
    """Names of the arrays of an npz.

    Raises:
        RecordingError: it is none.
    """
    with opened_archive(path) as archive:
        return list(archive.files)


def read_archive(path: Path, wanted: Sequence[str] | None = None) -> FileColumns:
    """Arrays of an npz, as numpy.savez writes it.

    By default all that hold numbers, one or many to a row.

    Raises:
        RecordingError: it is none or damaged, lacks an array, or one holds something else than rows
            of numbers.
    """
    with opened_archive(path) as archive:
        names = list(archive.files)
        if missing := [name for name in wanted or () if name not in names]:
            raise RecordingError(
                f"cannot read {path}: array '{missing[0]}' is missing: "
                f"{nearest_hint(missing[0], names)}"
            )
        try:
            arrays = {name: archive[name] for name in wanted or names}
        except Exception as error:  # damaged bytes fail in many ways, and so do objects
            raise RecordingError(f"cannot read {path}: {str(error).splitlines()[0]}") from error
    values: dict[str, Floats] = {}
    for name, array in arrays.items():
        if array.dtype.kind in "fiub" and array.ndim in (1, 2):
            values[name] = array.astype(np.float64)
        elif wanted is not None:
            found = f"is {array.dtype} of shape {array.shape}"
            raise RecordingError(
                f"{path}: '{name}' {found}; it must hold numbers, one or one for each joint to a "
                "row"
            )
    return FileColumns(values=values)


def opened_archive(path: Path) -> np.lib.npyio.NpzFile:
    """An npz that is whole, to be used as a context manager; `RecordingError` where it is none."""
    if not zipfile.is_zipfile(path):
        raise RecordingError(
            f"cannot read {path}: it is no archive of arrays, as numpy.savez writes it, or is cut "
            "off"
        )
    try:
        check_archive(path)
        return np.load(path, allow_pickle=False)
    except Exception as error:  # a damaged archive fails in many ways
        raise RecordingError(f"cannot read {path}: {str(error).splitlines()[0]}") from error


def _places(names: Sequence[str], wanted: Sequence[str] | None) -> dict[str, int]:
    """Where each wanted column stands."""
    wanted = (
        [name for name in dict.fromkeys(names) if name]
        if wanted is None
        else list(dict.fromkeys(wanted))
    )
    for name in wanted:
        if name not in names:
            raise ValueError(f"column '{name}' is missing: {nearest_hint(name, names)}")
        if names.count(name) > 1:
            raise ValueError(
                f"{names.count(name)} columns are named '{name}': which is meant? Rename all but "
                "one"
            )
    return {name: names.index(name) for name in wanted}


def _form(path: Path) -> _Form:
    """How a text is written, by its first lines."""
    encoding, lines = _first_lines(path)
    at = next(
        (
            i
            for i, line in enumerate(lines)
            if line.strip() and not line.lstrip().startswith(COMMENT)
        ),
        None,
    )
    if at is None:
        raise ValueError("it has no line with names of columns")
    told = lines[at].strip(' "')
    # As Excel writes it
    separator = told[4] if told.lower().startswith("sep=") and len(told) == 5 else None
    at += separator is not None
    header, skipped = lines[at] if at < len(lines) else "", at + 1
    before = lines[at - 1].lstrip() if at else ""
    if before.startswith(COMMENT) and _is_row(header, 0.5):
        header, first, skipped = before.lstrip(" #%/"), header, at  # as numpy.savetxt writes names
    elif _is_row(header, 1.0):
        raise ValueError("its first line has no names of columns; put one before it")
    else:
        first = next((line for line in lines[at + 1 :] if line.strip()), "")
    separator = separator or _separator(header, first)
    names = _cut(header, separator)
    # a logger may end its rows, but not its names, with a separator
    names += [""] * (len(_cut(first, separator)) == len(names) + 1)
    return _Form(names=names, separator=separator, encoding=encoding, skipped=skipped)


def _first_lines(path: Path) -> tuple[str, list[str]]:
    """Encoding of a text, and the lines that its beginning holds."""
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    mark, encoding = next(
        ((m, e) for m, e in BYTE_ORDER_MARKS.items() if head.startswith(m)), (b"", "utf-8")
    )
    try:
        text = codecs.getincrementaldecoder(encoding)().decode(
            head[len(mark) :], final=len(head) < HEAD_BYTES
        )
    except UnicodeDecodeError:
        # As Windows writes degrees and Greek letters
        text, encoding = (
            head.decode("latin-1"),
            "latin-1",
        )
    if "\0" in text:
        lost = (
            "\0" not in text.rstrip("\0\r\n")
            and len(text.splitlines()) > 1
            and encoding != "latin-1"
        )
        cure = (
            "ends in zero bytes, as after a loss of power: "
            "`tr -d '\\000' < FILE > NEW` takes them out"
        )
        raise ValueError(f"it {cure if lost else 'is no text'}")
    return encoding, text.splitlines()


def _is_row(line: str, share: float) -> bool:
    """True for a line of whose parts a share or more are numbers."""
    for separator in SEPARATORS:
        parts = [part for part in _cut(line, separator) if part]
        if parts and sum(NUMBER.fullmatch(part) is not None for part in parts) >= share * len(
            parts
        ):
            return True
    return False


def _separator(header: str, first: str) -> str:
    for separator in SEPARATORS:
        names, values = _cut(header, separator), _cut(first, separator)
        if len(names) > 1 and (not first or len(values) - len(names) in (0, 1)):
            return separator
    if "," in header and first.count(",") > header.count(","):
        raise ValueError(
            f"{header.count(',') + 1} names, but {first.count(',') + 1} parts of the first row: if "
            "its decimal signs "
            "are commas, write it with semicolons between columns"
        )
    return ","


def _cut(line: str, separator: str) -> list[str]:
    """Parts of a line, without spaces and quotes around them."""
    if separator == " ":
        return line.split()
    parts = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    return [part.strip().strip('"') for part in parts]


def _parsed(path: Path, form: _Form, places: list[int]) -> tuple[pa.Table, tuple[str, ...]]:
    """The columns at some places, named by their numbers, as two may have one name; and notes."""
    try:
        return _table(_source(path, form), form, places), ()
    except pa.ArrowInvalid as error:
        uneven = UNEVEN.search(str(error))
        if uneven is None:
            raise ValueError(_of_column(str(error), form)) from error
    whole = _whole_lines(path, form)
    if whole is not None:
        with contextlib.suppress(pa.ArrowInvalid):
            return _table(whole, form, places), (
                f"the last row of {path.name} is cut off, and left out",
            )
    row = f"row {int(uneven[1]) - form.skipped}" if uneven[1] else "a row"
    raise ValueError(f"{row} has {uneven[3]} columns, the line of names {uneven[2]}")


def _table(source: object, form: _Form, places: list[int]) -> pa.Table:
    """Columns with decimal points, or, where one cannot be read so, with commas."""
    # With threads and memory of its own Arrow keeps 40 MB after two hundred small logs; 30,000 rows
    # come no faster.
    read = pyarrow.csv.ReadOptions(
        column_names=[str(place) for place in range(len(form.names))],
        skip_rows=form.skipped,
        use_threads=False,
    )
    parse = pyarrow.csv.ParseOptions(delimiter="," if form.separator == " " else form.separator)
    names, failures = [str(place) for place in places], []
    for sign in DECIMAL_SIGNS:
        convert = pyarrow.csv.ConvertOptions(
            column_types=dict.fromkeys(names, pa.float64()),
            include_columns=names,
            decimal_point=sign,
        )
        try:
            if isinstance(source, io.BytesIO):
                source.seek(0)
            return pyarrow.csv.read_csv(
                source, read, parse, convert, memory_pool=pa.system_memory_pool()
            )
        except pa.ArrowInvalid as error:
            failures.append(error)
    raise next((each for each in failures if UNEVEN.search(str(each))), failures[0])


def _source(path: Path, form: _Form) -> object:
    """A text as Arrow reads it: bytes of UTF-8 or of ASCII, one separator between columns."""
    if form.separator != " " and not form.encoding.startswith("utf-16"):
        return path
    lines = path.read_text(encoding=form.encoding).splitlines()
    if form.separator == " ":
        lines = [",".join(line.split()) for line in lines]
    return io.BytesIO("\n".join(lines).encode())


def _whole_lines(path: Path, form: _Form) -> io.BytesIO | None:
    """A text without its last line, which its writer did not end; None where all are ended."""
    source = _source(path, form)
    data = source.getvalue() if isinstance(source, io.BytesIO) else path.read_bytes()
    if path.read_bytes().rstrip(b"\0").endswith((b"\n", b"\r")):
        return None
    return io.BytesIO(data[: max(data.rfind(b"\n"), data.rfind(b"\r")) + 1])


def _of_column(said: str, form: _Form) -> str:
    """Arrow's message about a column, with the column's name in place of its number."""
    found = re.match(
        r"In CSV column #(\d+): (?:Row #(\d+): )?CSV conversion error to double: (.*)",
        said,
        re.DOTALL,
    )
    if not found:
        return said
    row = int(found[2]) - form.skipped if found[2] else 0
    text = (
        f"column '{form.names[int(found[1])]}'{f', row {row}' if row else ''}: "
        f"{found[3].splitlines()[0]}"
    )
    is_unit = row == 1 and not re.search(r"\d", found[3].splitlines()[0])
    return (
        f"{text}; is it a row of units? Delete it" if is_unit else f"{text}; it must hold numbers"
    )
