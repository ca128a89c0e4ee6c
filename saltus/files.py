"""Files and folders that are written whole or not at all:
whoever reads them finds all of them or nothing.
"""

import os
import shutil
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def atomic_write(path: Path, *, synced: bool = False) -> Iterator[Path]:
    """A path beside a file, to write there what takes its place when that is done.

    Args:
        path: The file, in a folder that is there. Where writing fails it stays as it is, and
            nothing is left beside it.
        synced: Wait until the disk has it, so that a loss of power leaves the earlier file or the
            new one.
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        yield partial
        if synced:
            _sync(partial)
        partial.replace(path)
        if synced:
            _sync(path.parent)
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def write_whole(path: Path, text: str, *, synced: bool = False) -> None:
    """Writes a text in UTF-8, see `atomic_write`; `OSError` where it cannot."""
    with atomic_write(path, synced=synced) as partial:
        partial.write_text(text, encoding="utf-8")


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """A folder to fill, which gets its name when that is done.

    What an interruption left of it is removed before.
    """
    temporary = folder.with_name(f".{folder.name}.partial")
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir(parents=True)
    yield temporary
    temporary.replace(folder)


def _sync(path: Path) -> None:
    opened = os.open(path, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)


ARCHIVE_MAX = 4 * 2**30
"""Bytes that an archive may unpack to: an hour and a half of the depth images of a D435i as Saltus
records them."""


def check_archive(path: Path, *, checksums: bool = False) -> None:
    """Refuses an archive before it is unpacked;
    `checksums` of all that is in it too, for readers that leave them out.

    Raises:
        OSError: it cannot be read.
        ValueError: it is none, unpacks to too much, or is damaged.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
            if size > ARCHIVE_MAX:
                raise ValueError(f"it unpacks to {size} bytes, at most {ARCHIVE_MAX} are allowed")
            damaged = archive.testzip() if checksums else None
    except OSError:
        raise
    except Exception as error:  # damaged bytes fail in many ways
        raise ValueError(str(error)) from error
    if damaged is not None:
        raise ValueError(f"'{damaged}' in it is damaged")
