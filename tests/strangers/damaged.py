"""Bags that are none, were cut off, or were not closed; and recordings of RealSense cameras."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from strangers.bags import Bag, write
from strangers.stranger import Stranger, described


def _damage(
    bag: Bag, change: Callable[[bytes], bytes], name: str | None = None
) -> Callable[[Path], Path]:
    """A bag whose file is changed, and lies by another name."""

    def written(folder: Path) -> Path:
        path = write(bag, folder)
        if path.is_dir():
            (path / "metadata.yaml").unlink()
            path = next(path.iterdir())
        data = path.read_bytes()
        path = path if name is None else path.with_name(name)
        path.write_bytes(change(data))
        return path

    return written


def _half(data: bytes) -> bytes:
    return data[: len(data) // 2]


def _unindexed(data: bytes) -> bytes:
    """The head of a bag says where its index begins; 0 until it is closed."""
    place = data.index(b"index_pos=") + len(b"index_pos=")
    return data[:place] + bytes(8) + data[place + 8 :]


def _same(data: bytes) -> bytes:
    return data


def _raw(name: str, data: bytes) -> Callable[[Path], Path]:
    def written(folder: Path) -> Path:
        (folder / name).write_bytes(data)
        return folder / name

    return written


def _folder(*names: str) -> Callable[[Path], Path]:
    def written(folder: Path) -> Path:
        (folder / "bag").mkdir()
        for name in names:
            (folder / "bag" / name).write_bytes(b"text")
        return folder / "bag"

    return written


NOISE = np.random.default_rng(7).integers(0, 256, 5000).astype(np.uint8).tobytes()
ROS1, MCAP, SQLITE = Bag(kind="ros1"), Bag(kind="mcap"), Bag(kind="sqlite3")
BY_WHAT = {
    "a random .bag": (_raw("run.bag", NOISE), "is no bag of ROS 1: it does not begin like one"),
    "a random .mcap": (_raw("run.mcap", NOISE), "is no MCAP: it does not begin like one"),
    "a random .db3": (
        _raw("run.db3", NOISE),
        "is no database of rosbag2: it does not begin like one",
    ),
    "an empty .bag": (_raw("run.bag", b""), "is empty: its recorder was stopped"),
    "an empty .mcap": (_raw("run.mcap", b""), "is empty: its recorder was stopped"),
    "a bag of version 1.2": (
        _raw("run.bag", b"#ROSBAG V1.2\n" + NOISE),
        "version 102 .*`rosbag migrate`",
    ),
    "a head alone": (_raw("run.bag", b"#ROSBAG V2.0\n"), "or damaged"),
    ".bag.active": (
        _damage(ROS1, _unindexed, "run.bag.active"),
        "was not closed by its recorder: `rosbag reindex",
    ),
    "a bag without index": (_damage(ROS1, _unindexed), "not indexed, .*`rosbag reindex`"),
    "a bag cut off": (_damage(ROS1, _half), "or damaged"),
    "an MCAP cut off": (_damage(MCAP, _half), "cut off: `mcap recover`"),
    "a database cut off": (_damage(SQLITE, _half), "`sqlite3 FILE .recover`"),
    "an MCAP named .bag": (
        _damage(MCAP, _same, "run.bag"),
        "is no bag of ROS 1: .*but an MCAP: rename it",
    ),
    "a bag named .mcap": (
        _damage(ROS1, _same, "run.mcap"),
        "is no MCAP: .*but a bag of ROS 1: rename it",
    ),
    "a bag by another name": (
        _damage(ROS1, _same, "run.old"),
        "name it by what it is: .bag, .mcap or .db3",
    ),
    "a bag in capitals": (
        _damage(MCAP, _same, "RUN.MCAP"),
        "name it by what it is: .bag, .mcap or .db3",
    ),
    "a folder of something else": (
        _folder("notes.txt"),
        "holds neither metadata.yaml nor a file .bag, .mcap, .db3",
    ),
    "an empty folder": (_folder(), "holds neither metadata.yaml nor a file"),
    "a folder of packed files": (_folder("run.mcap.zstd"), "`unzstd` them first"),
    "a folder with nonsense for metadata": (_folder("metadata.yaml"), "delete metadata.yaml"),
}
DAMAGED: tuple[Stranger, ...] = tuple(
    Stranger(name=name, write=written, description=described(), says=says)
    for name, (written, says) in BY_WHAT.items()
)
