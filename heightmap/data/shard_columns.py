"""Arrays of a shard, compressed and read by all cores.

On disk they are what HDF5's own filters write and read.
"""

import zlib
from concurrent.futures import Executor
from pathlib import Path

import h5py
import numpy as np

from saltus.arrays import AnyArray

CHUNK = 256
"""Rows that are compressed together."""
# Of zlib: stereo images get 8 % larger than at HDF5's usual 4, in two thirds of the time; 1 is no
# faster
_LEVEL = 2
_RATIO_MAX = 1040  # zlib's, of zeros: 1032
_TOGETHER = 64  # chunks: enough for all cores, and 25 MB of images


class ShardColumn:
    """One column of a shard: an array that grows in its file; its rows are like those of `like`.

    HDF5 compresses on one core, which would take longer than a GPU takes to make the data: here a
    pool of threads does.
    """

    def __init__(self, file: h5py.File, name: str, like: AnyArray, pool: Executor) -> None:
        row = like.shape[1:]
        self._dataset = file.create_dataset(
            name, shape=(0, *row), maxshape=(None, *row), chunks=(CHUNK, *row), dtype=like.dtype,
            compression="gzip", compression_opts=_LEVEL, shuffle=True,
        )  # fmt: skip
        self._pool = pool
        self._waiting: list[AnyArray] = []
        self._count = 0

    def append(self, rows: AnyArray) -> None:
        """Adds rows; they are written when enough have come together."""
        self._waiting.append(rows)
        self._count += len(rows)
        if self._count >= CHUNK * _TOGETHER:
            self._write(self._count // CHUNK * CHUNK)

    def close(self) -> None:
        """Writes what is left."""
        self._write(self._count)

    def _write(self, count: int) -> None:
        rows = (
            np.concatenate(self._waiting)
            if self._waiting
            else np.empty((0, *self._dataset.shape[1:]))
        )
        self._waiting, self._count = [rows[count:]], self._count - count
        first = len(self._dataset)
        self._dataset.resize(first + count, axis=0)
        chunks = [rows[begin : min(begin + CHUNK, count)] for begin in range(0, count, CHUNK)]
        for i, data in enumerate(self._pool.map(_compressed, chunks)):
            self._dataset.id.write_direct_chunk(
                (first + i * CHUNK, *(0 for _ in rows.shape[1:])), data
            )


def check_own(file: h5py.File, name: str) -> None:
    """Refuses an array that lies elsewhere, or says that it is larger than its file can be.

    Raises `ValueError`.
    """
    is_own = isinstance(file.get(name, getlink=True), h5py.HardLink) and isinstance(
        file[name], h5py.Dataset
    )
    if not is_own or file[name].external or file[name].is_virtual:
        raise ValueError(f"'{name}' is no array of this file")
    if file[name].nbytes > _RATIO_MAX * Path(file.filename).stat().st_size:
        raise ValueError(
            f"'{name}' says that it has {file[name].nbytes} bytes, more than such a file holds"
        )


def read_column(dataset: h5py.Dataset, pool: Executor) -> AnyArray:
    """All rows of an array that `ShardColumn` wrote, or HDF5 itself."""
    if (
        dataset.compression != "gzip"
        or not dataset.shuffle
        or dataset.chunks[1:] != dataset.shape[1:]
    ):
        rows: AnyArray = dataset[:]
        return rows
    result = np.empty(dataset.shape, dataset.dtype)
    size = dataset.chunks[0]

    def fill(first: int) -> None:
        skipped, data = dataset.id.read_direct_chunk((first, *(0 for _ in dataset.shape[1:])))
        if skipped:  # HDF5 leaves a filter out where it makes a chunk longer
            result[first : first + size] = dataset[first : first + size]
            return
        # No more than there is room for
        plain = zlib.decompressobj().decompress(data, size * result[:1].nbytes)
        planes = np.frombuffer(plain, np.uint8).reshape(dataset.dtype.itemsize, -1)
        part = np.empty(planes.shape[::-1], np.uint8)
        for i, plane in enumerate(planes):  # several times as fast as a transposed copy
            part[:, i] = plane
        result[first : first + size] = part.view(dataset.dtype).reshape(dataset.chunks)[
            : len(result) - first
        ]

    list(pool.map(fill, range(0, len(result), size)))
    return result


def _compressed(rows: AnyArray) -> bytes:
    """A chunk through the filters of HDF5: first bytes of all numbers,
    second bytes, ..., then zlib.
    """
    chunk = np.zeros((CHUNK, *rows.shape[1:]), rows.dtype)
    chunk[: len(rows)] = rows
    return zlib.compress(chunk.view(np.uint8).reshape(-1, rows.itemsize).T.tobytes(), _LEVEL)
