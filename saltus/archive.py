"""Zip archives from anywhere, as numpy and torch write them: whole, and no larger than they may be."""

import zipfile
from pathlib import Path

ARCHIVE_MAX = 4 * 2**30
"""Bytes that an archive may unpack to: an hour and a half of the depth images of a D435i as Saltus records them."""


def check_archive(path: Path, *, checksums: bool = False) -> None:
    """Refuses an archive before it is unpacked; `checksums` of all that is in it too, for readers that leave them out.

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
