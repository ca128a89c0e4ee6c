"""The kind of somebody else's recording, by its first bytes."""

import zipfile
from pathlib import Path
from typing import Literal

from saltus.errors import RecordingError

Kind = Literal["bag", "text", "Parquet", "npz"]

BEGINNINGS: dict[bytes, Kind] = {
    b"#ROSBAG": "bag",
    b"\x89MCAP": "bag",
    b"SQLite format 3\0": "bag",
    b"PAR1": "Parquet",
    b"PK": "npz",
}
OF_OTHERS = {
    b"\x89HDF": "an HDF5 file (or a .mat of MATLAB)",
    b"MATLAB": "a .mat of MATLAB",
    b"\x93NUMPY": "a single array of numpy",
    b"\x80\x04": "a pickle of Python",
    b"\x80\x05": "a pickle of Python",
    b"\x80\x02": "a pickle of Python",
    b"\x1f\x8b": "compressed by gzip: unpack it first",
    b"\x28\xb5\x2f\xfd": "compressed by zstd: unpack it first",
    b"\xd0\xcf\x11\xe0": "an old workbook of Excel",
}
BAGS = (".bag", ".active", ".mcap", ".db3")
"""Endings of files that are refused as bags where they are none."""
KINDS = "a bag of ROS, a text of columns (CSV), Parquet or npz"


def kind_of(path: Path) -> Kind:
    """Kind of a recording.

    Raises:
        RecordingError: it is empty, cannot be read, or is of a kind that nothing reads; says what
            to make of it.
    """
    if path.is_dir():
        return "bag"
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except OSError:
        return "text"  # its reader says why
    if path.suffix.lower() in BAGS:
        return "bag"  # also where it does not begin like one: the reader of bags says why
    if not head:
        raise RecordingError(f"{path} is empty")
    for beginning, what in OF_OTHERS.items():
        if head.startswith(beginning):
            raise RecordingError(
                f"{path} is {what}; `import` reads {KINDS}: numpy.savez(file, t=..., q=...) writes "
                "one"
            )
    kind: Kind = next(
        (kind for beginning, kind in BEGINNINGS.items() if head.startswith(beginning)), "text"
    )
    if kind == "npz":
        _check_npz(path)
    return kind


def _check_npz(path: Path) -> None:
    """Refuses archives of others, which begin alike."""
    if not zipfile.is_zipfile(path):
        return  # the reader says that it is cut off
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    if any(name.endswith(".npy") for name in names):
        return
    if "[Content_Types].xml" in names:
        raise RecordingError(f"{path} is a workbook of Excel: save its sheet as CSV")
    if any(name.endswith("data.pkl") for name in names):
        raise RecordingError(f"{path} is a file of torch: write its arrays with numpy.savez")
    raise RecordingError(f"{path} is a zip of other files; `import` reads {KINDS}: unpack it")
