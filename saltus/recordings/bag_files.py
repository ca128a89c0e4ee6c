"""Opens bags of ROS as they lie about: rosbag2 in SQLite or MCAP,
with or without metadata, and bags of ROS 1.
"""

from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Reader as Reader1
from rosbags.typesys import Stores, get_typestore

from saltus.errors import RecordingError

UNPACKED_MAX = 2**26  # bytes of chunks of ROS 1 that are kept: dozens, of about a megabyte each
ROS1, MCAP, SQLITE = b"#ROSBAG V", b"\x89MCAP0\r\n", b"SQLite format 3\0"
BEGINS = {".bag": ROS1, ".mcap": MCAP, ".db3": SQLITE}
KINDS = {".bag": "bag of ROS 1", ".mcap": "MCAP", ".db3": "database of rosbag2"}
CURES = {
    "not indexed": "`rosbag reindex` makes its index",
    "File end magic is invalid": "it is cut off: `mcap recover` saves what is whole",
    "Truncated record": "it is cut off: `mcap recover` saves what is whole",
    "malformed": "it is damaged or cut off: `sqlite3 FILE .recover` saves what is whole",
    "Profile is not ros2": "it was not written by ROS 2: convert its messages to those of ROS 2",
    "version 10": "`rosbag migrate` (or `rosbag fix`) makes a bag of version 2.0 of it",
    "metadata key is missing": "delete metadata.yaml: the files beside it are read without",
    "Invalid bag metadata": "delete metadata.yaml: the files beside it are read without",
    "Could not load YAML": "delete metadata.yaml: the files beside it are read without",
    "database files are missing": "delete metadata.yaml if the rest is enough: "
    "files are read without it, too",
    "Unrecognized storage format": "name it by what it is: .bag, .mcap or .db3",
}
"""The cure, by words of the library's message."""


@contextmanager
def reading(path: Path, kind: str) -> Iterator[None]:
    """Says of whatever goes wrong with a file that it cannot be read, or is none of its kind.

    Raises:
        RecordingError: with one line.
    """
    try:
        yield
    except RecordingError:
        raise
    except OSError as error:
        raise RecordingError(f"cannot read the {kind} {path}: {error}") from error
    except Exception as error:  # damaged bytes fail in many ways; all mean the same
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        cure = next((f"; {cure}" for words, cure in CURES.items() if words in reason), "")
        raise RecordingError(f"{path} is no {kind}, or damaged: {reason}{cure}") from error


@contextmanager
def open_bag(path: Path, kind: str = "recording of ROS") -> Iterator[AnyReader]:
    """A reader of a bag.

    Args:
        path: File, or folder with metadata.yaml or with the files alone.
        kind: What the path should be, for messages.

    Raises:
        RecordingError: no bag, or a damaged one; says what would help.
    """
    types = get_typestore(Stores.ROS2_JAZZY)  # of a bag that does not hold its own
    with reading(path, kind), AnyReader(_paths(path), default_typestore=types) as reader:
        for each in reader.readers:
            if isinstance(each, Reader1):
                _keep_unpacked(each)
        yield reader


def _paths(path: Path) -> list[Path]:
    """Files of a bag, or its folder."""
    if path.suffix == ".active" or path.name.endswith(".bag.active"):
        raise RecordingError(
            f"{path} was not closed by its recorder: `rosbag reindex {path.name}` makes its index"
        )
    if not path.is_dir():
        _check(path)
        return [path]
    if (path / "metadata.yaml").exists():
        return [path]
    files = sorted(file for file in path.iterdir() if file.suffix in BEGINS)
    if not files:
        if active := sorted(path.glob("*.bag.active")):
            return _paths(active[0])
        packed = " (.zstd: `unzstd` them first)" if any(path.glob("*.zstd")) else ""
        raise RecordingError(
            f"{path} holds neither metadata.yaml nor a file {', '.join(BEGINS)}{packed}"
        )
    if len({file.suffix for file in files}) > 1:
        raise RecordingError(
            f"{path} holds {', '.join(file.name for file in files[:4])}: name one of them"
        )
    for file in files:
        _check(file)
    return files  # parts of a recording whose metadata is lost


def _check(path: Path) -> None:
    with path.open("rb") as file:
        head = file.read(16)
    if not head:
        raise RecordingError(f"{path} is empty: its recorder was stopped before it wrote anything")
    begins = BEGINS.get(path.suffix)
    if begins is not None and not head.startswith(begins):
        is_other = next(
            (KINDS[ending] for ending, other in BEGINS.items() if head.startswith(other)), None
        )
        found = (
            f"but {'an' if is_other == 'MCAP' else 'a'} {is_other}: rename it"
            if is_other
            else "and was not, or is damaged"
        )
        raise RecordingError(
            f"{path} is no {KINDS[path.suffix]}: it does not begin like one, {found}"
        )


def _keep_unpacked(reader: Reader1) -> None:
    """Lets a reader unpack each chunk once, where messages of several chunks alternate.

    Bz2 takes 0.1 s for one.
    """
    kept: OrderedDict[int, bytes] = OrderedDict()

    def unpacker(place: int, unpack: Callable[[bytes], bytes]) -> Callable[[bytes], bytes]:
        def once(packed: bytes) -> bytes:
            data = kept.pop(place, None)
            kept[place] = unpack(packed) if data is None else data
            while len(kept) > 1 and sum(map(len, kept.values())) > UNPACKED_MAX:
                kept.popitem(last=False)
            return kept[place]

        return once

    for place, chunk in reader.chunks.items():
        reader.chunks[place] = chunk._replace(decompressor=unpacker(place, chunk.decompressor))
