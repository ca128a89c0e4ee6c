"""Tables of joints: texts with any separator,
decimal sign and encoding, Parquet, and archives of numpy.
"""

import io
import pickle
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from saltus.recordings.recording_description import RecordingDescription, TableColumns
from saltus.recordings.run_log import RunLog
from saltus.robots.robot import JOINTS
from strangers.stranger import Stranger, same_joints, truth

COLUMNS = TableColumns(time="t", q="q {joint}", dq="dq {joint}", q_des="told {joint}")
DESCRIPTION = RecordingDescription(claims={"base": "fixed", "kp": 20.0, "kd": 0.5}, columns=COLUMNS)
SIGNALS = {"q": "q", "dq": "dq", "q_des": "told"}


@dataclass(frozen=True, kw_only=True)
class Text:
    """How a text is written."""

    separator: str = ","
    decimal: str = "."
    encoding: str = "utf-8"
    ending: str = ".csv"
    newline: str = "\n"
    before: Sequence[str] = ()
    mark: str = ""
    """Before the names."""
    quotes: bool = False
    trailing: bool = False
    """Rows end with a separator."""
    damage: Callable[[list[str]], list[str]] | None = None


def columns(*, space: str = " ") -> dict[str, np.ndarray]:
    """The truth by names of columns."""
    log = truth()
    named = {"t": log.joints.time_s}
    for signal, word in SIGNALS.items():
        named |= {
            f"{word}{space}{joint}": getattr(log.joints, signal)[:, i]
            for i, joint in enumerate(JOINTS)
        }
    return named


def lines(form: Text, named: dict[str, np.ndarray] | None = None) -> list[str]:
    """The rows of a text, after its names.

    A column of words and one of degrees stand between the others.
    """
    named = columns(space="_" if form.separator == " " else " ") if named is None else named
    said = (
        list(named)
        if form.separator == " "
        else [*named, "mode", "Temp [°C]" if form.encoding != "ascii" else "T"]
    )
    if form.quotes:
        said = [f'"{name}"' for name in said]
    rows = [form.mark + form.separator.join(said)]
    for row in zip(*named.values(), strict=True):
        values = [repr(float(value)).replace(".", form.decimal) for value in row]
        if form.separator != " ":
            values += ["stand", ""]
        if form.quotes:
            values = [f'"{value}"' for value in values]
        rows.append(form.separator.join(values) + (form.separator if form.trailing else ""))
    return rows


def write_text(form: Text, folder: Path) -> Path:
    rows = lines(form)
    if form.damage is not None:
        rows = form.damage(rows)
    path = folder / f"mine{form.ending}"
    text = form.newline.join([*form.before, *rows, *([] if form.damage is cut_off else [""])])
    path.write_bytes(text.encode(form.encoding))
    return path


def cut_off(rows: list[str]) -> list[str]:
    """A logger was killed while it wrote the last row."""
    return [*rows[:-1], rows[-1][: len(rows[-1]) // 2]]


def _read(form: Text, *, says: str = "", rows: slice = slice(None), **described: Any) -> Stranger:
    words = {"separator": "", "decimal": "", "encoding": "", "ending": "", "newline": ""}
    name = " ".join(repr(getattr(form, key)) for key in words)
    extra = [
        form.mark,
        *form.before,
        "quotes" * form.quotes,
        "trailing" * form.trailing,
        getattr(form.damage, "__name__", ""),
    ]
    own = (
        replace(COLUMNS, q="q_{joint}", dq="dq_{joint}", q_des="told_{joint}")
        if form.separator == " "
        else COLUMNS
    )
    return Stranger(
        name=" ".join([f"text {name}", *filter(None, extra)]),
        write=partial(write_text, form),
        description=replace(DESCRIPTION, columns=own, **described),
        check=partial(same_joints, lacks=("dq_des", "tau_ff", "tau_est"), rows=rows),
        says=says,
    )


def _forms() -> list[Text]:
    """Every separator with every decimal sign that it may have, and with every encoding."""
    forms = [
        Text(separator=separator, decimal=decimal, encoding=encoding)
        for separator, decimal in (
            (",", "."),
            (";", "."),
            (";", ","),
            ("\t", "."),
            ("\t", ","),
            ("|", "."),
            ("|", ","),
        )
        for encoding in ("utf-8", "utf-8-sig", "utf-16", "latin-1")
    ]
    forms += [Text(separator=" ", newline=newline) for newline in ("\n", "\r\n")]
    forms += [Text(ending=ending) for ending in (".CSV", ".txt", ".tsv", ".log", ".dat", "")]
    forms += [Text(newline="\r\n", separator=separator) for separator in (",", ";", "\t")]
    forms += [Text(mark="# ", encoding=encoding) for encoding in ("utf-8", "utf-8-sig")]
    forms += [Text(mark="# ", separator=" "), Text(mark="%", separator="\t")]
    forms += [
        Text(before=("# robot: mine", "", "# Monday, in the lab; 3,5 kg")),
        Text(before=("sep=;",), separator=";"),
        Text(before=("sep=\t",), separator="\t"),
    ]
    forms += [
        Text(quotes=True, separator=separator, decimal=decimal)
        for separator, decimal in ((",", ","), (";", "."), ("\t", ","))
    ]
    forms += [Text(trailing=True, separator=separator) for separator in (",", ";", "\t")]
    return forms


def _with(text: str, row: int = 50) -> Callable[[list[str]], list[str]]:
    """A text in place of the first value of a row."""

    def damage(rows: list[str]) -> list[str]:
        return [
            *rows[:row],
            ",".join([rows[row].split(",")[0], text, *rows[row].split(",")[2:]]),
            *rows[row + 1 :],
        ]

    return damage


def _short_row(rows: list[str]) -> list[str]:
    return [*rows[:50], rows[50].rpartition(",")[0], *rows[51:]]


def _twice(rows: list[str]) -> list[str]:
    return [rows[0].replace("q FR_thigh", "q FR_hip", 1), *rows[1:]]


def _without_names(rows: list[str]) -> list[str]:
    return [row.replace("stand", "0") for row in rows[1:]]


def _many_names(rows: list[str]) -> list[str]:
    more = [f"motor{i}" for i in range(400)]
    return [
        ",".join([rows[0].replace("q FR_hip", "position 0"), *more]),
        *(row + ",0" * 400 for row in rows[1:]),
    ]


def _units(rows: list[str]) -> list[str]:
    return [rows[0], ",".join(["[s]"] + ["[rad]"] * rows[0].count(",")), *rows[1:]]


def _zeros(rows: list[str]) -> list[str]:
    return [*rows, "\0" * 512]


def _dates(rows: list[str]) -> list[str]:
    return [rows[0], *(f"2026-11-27 08:00:{row}" for row in rows[1:])]


REFUSED_TEXTS = {
    "zeros at its end": (Text(damage=_zeros), "zero bytes, as after a loss of power: `tr -d"),
    "dates for times": (Text(damage=_dates), "column 't', row 1: .*2026.*must hold numbers"),
    "two columns of one name": (Text(damage=_twice), "2 columns are named 'q FR_hip'.*Rename"),
    "a word where a number is due": (
        Text(damage=_with("high")),
        "column 'q FR_hip', row 50: .*invalid value 'high'; it must",
    ),
    "thousands": (Text(damage=_with("1'000.5")), "column 'q FR_hip', row 50: .*1'000.5"),
    "a shorter row": (Text(damage=_short_row), "row 50 has 38 columns, the line of names 39"),
    "no names": (
        Text(damage=_without_names),
        "first line has no names of columns; put one before it",
    ),
    "hundreds of other names": (Text(damage=_many_names), "'q FR_hip' is missing: did you mean"),
    "a row of units": (
        Text(damage=_units),
        r"column 't', row 1: .*'\[s\]'.*row of units\? Delete it",
    ),
    "decimal commas between commas": (
        Text(decimal=","),
        "decimal signs are commas, write it with semicolons",
    ),
}


def _npz(folder: Path, named: dict[str, Any], name: str = "mine.npz") -> Path:
    np.savez(folder / name, **named)
    return (folder / name) if (folder / name).exists() else folder / f"{name}.npz"


def _arrays() -> dict[str, np.ndarray]:
    log = truth()
    return {
        "time": log.joints.time_s.astype(np.float64),
        **{name: getattr(log.joints, name) for name in SIGNALS},
    }


def _parquet(folder: Path) -> Path:
    pyarrow.parquet.write_table(pa.table(columns()), folder / "mine.parquet")
    return folder / "mine.parquet"


def _raw(name: str, data: bytes) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (folder / name).write_bytes(data)
        return folder / name

    return write


def _zip(name: str, *inside: str) -> Callable[[Path], Path]:
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as archive:
        for entry in inside:
            archive.writestr(entry, b"0")
    return _raw(name, data.getvalue())


ARRAYS = replace(DESCRIPTION, columns=TableColumns(time="time", q="q", dq="dq", q_des="q_des"))
EVEN = replace(DESCRIPTION, columns=TableColumns(rate_hz=500.0, q="q", dq="dq", q_des="q_des"))
SINGLE = replace(
    DESCRIPTION,
    columns=TableColumns(time="t", q="q {joint}", dq="dq {joint}", q_des="told {joint}"),
)
SEVERAL = replace(
    DESCRIPTION,
    columns=TableColumns(rate_hz=500.0, q="{log}/q", dq="{log}/dq", q_des="{log}/q_des"),
)
LACKS = ("dq_des", "tau_ff", "tau_est")


def _objects() -> dict[str, Any]:
    return _arrays() | {"q": np.array([pickle.dumps(1)] * 3, dtype=object)}


def _half(log: RunLog) -> None:
    """The first of several logs holds the first half."""
    same_joints(log, lacks=LACKS, rows=slice(0, 75))


def _halves(folder: Path) -> Path:
    whole = {name: values for name, values in _arrays().items() if name != "time"}
    first = {f"a/{name}": values[:75] for name, values in whole.items()}
    return _npz(
        folder,
        first
        | {f"b/{name}": values[75:] for name, values in whole.items()}
        | {"c/q": whole["q"][:5], "c/dq": whole["dq"][:5], "c/q_des": whole["q_des"][:5]},
    )


def _of(
    name: str, write: Callable[[Path], Path], description: RecordingDescription, says: str = ""
) -> Stranger:
    return Stranger(
        name=name,
        write=write,
        description=description,
        check=partial(same_joints, lacks=LACKS),
        says=says,
    )


def _no(
    name: str,
    write: Callable[[Path], Path],
    says: str,
    description: RecordingDescription = DESCRIPTION,
) -> Stranger:
    return Stranger(name=name, write=write, description=description, says=says)


TABLES: tuple[Stranger, ...] = (
    *(_read(form) for form in _forms()),
    _read(Text(damage=cut_off), rows=slice(0, 149), says="last row of mine.csv is cut off"),
    _read(
        Text(damage=cut_off, separator=";", decimal=",", newline="\r\n"),
        rows=slice(0, 149),
        says="cut off",
    ),
    *(
        _no(f"text with {name}", partial(write_text, form), says)
        for name, (form, says) in REFUSED_TEXTS.items()
    ),
    _no(
        "one column for all joints",
        partial(write_text, Text()),
        "names one column for all joints: put {number} or",
        replace(DESCRIPTION, columns=replace(COLUMNS, q="q FR_hip")),
    ),
    _of("Parquet", _parquet, DESCRIPTION),
    _of("npz of whole arrays", lambda folder: _npz(folder, _arrays()), ARRAYS),
    _of("npz of a fixed rate", lambda folder: _npz(folder, _arrays()), EVEN),
    _of(
        "npz of 32 bits with other arrays",
        lambda folder: _npz(folder, _arrays() | {"names": np.array(JOINTS), "m": np.eye(3)}),
        ARRAYS,
    ),
    _of("npz of single columns", lambda folder: _npz(folder, columns()), SINGLE),
    _of("npz by another name", lambda folder: _npz(folder, _arrays(), "log.dat.npz"), ARRAYS),
    Stranger(
        name="npz of several logs",
        write=_halves,
        description=SEVERAL,
        check=_half,
        says="c: 5 rows are too few",
    ),
    _no(
        "npz without an array",
        lambda folder: _npz(folder, {"time": np.arange(9.0)}),
        "array 'q' is missing",
        ARRAYS,
    ),
    _no(
        "npz of other joints",
        lambda folder: _npz(folder, _arrays() | {"q": np.zeros((150, 8))}),
        "'q' is of 8 joints",
        ARRAYS,
    ),
    _no(
        "npz of unequal rows",
        lambda folder: _npz(folder, _arrays() | {"q": np.zeros((99, 12))}),
        "unequal length",
        ARRAYS,
    ),
    _no(
        "npz of objects",
        lambda folder: _npz(folder, _objects()),
        "cannot read .*allow_pickle",
        ARRAYS,
    ),
    _no(
        "npz of images",
        lambda folder: _npz(folder, _arrays() | {"q": np.zeros((9, 9, 9))}),
        "'q' is .*must hold numbers",
        ARRAYS,
    ),
    _no("a zip cut off", _raw("mine.npz", b"PK\x03\x04 and no more"), "is cut off", ARRAYS),
    _no(
        "a workbook",
        _zip("mine.xlsx", "[Content_Types].xml", "xl/workbook.xml"),
        "workbook of Excel: save its sheet as CSV",
    ),
    _no(
        "a file of torch",
        _zip("mine.pt", "mine/data.pkl", "mine/data/0"),
        "file of torch: write its arrays with numpy.savez",
    ),
    _no("a zip of texts", _zip("mine.zip", "mine.csv"), "zip of other files; .*unpack it"),
    _no("HDF5", _raw("mine.h5", b"\x89HDF\r\n\x1a\n" + bytes(99)), "is an HDF5 file.*numpy.savez"),
    _no(
        "MATLAB",
        _raw("mine.mat", b"MATLAB 5.0 MAT-file" + bytes(99)),
        "is a .mat of MATLAB.*numpy.savez",
    ),
    _no(
        "a pickle",
        _raw("mine.pkl", pickle.dumps({"q": [1.0]})),
        "is a pickle of Python.*numpy.savez",
    ),
    _no(
        "a single array",
        _raw("mine.npy", b"\x93NUMPY\x01\x00"),
        "is a single array of numpy.*numpy.savez",
    ),
    _no(
        "gzip",
        _raw("mine.csv.gz", b"\x1f\x8b\x08" + bytes(20)),
        "compressed by gzip: unpack it first",
    ),
    _no("nothing", _raw("mine.csv", b""), "is empty"),
    _no("bytes", _raw("mine.csv", bytes(range(256)) * 9), "it is no text"),
    _no("an image", _raw("mine.csv", b"\x89PNG\r\n\x1a\n" + bytes(99)), "it is no text"),
)
