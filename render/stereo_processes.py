"""Stereo depth for training on several cores: a process on each.

Threads would wait for each other: the effects are thousands of short calls into numpy, between which Python lets only
one thread run.
"""

import ctypes
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from saltus.errors import SaltusError
from saltus.render.camera import Mount
from saltus.render.renderer import check_poses
from saltus.render.stereo.camera import StereoConfig
from saltus.render.stereo.model_view import COLUMNS, ROWS
from saltus.render.stereo_fast import FastState, FastStereo
from saltus.terrain.terrain import Terrain
from saltus.wire.messages import Floats

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # malloc.h
HEAP_BYTES = 1 << 28  # more than a process ever has free: the arrays of a chunk of cameras take 30 MB
ARRAY_BYTES = 1 << 25  # the most that glibc takes; larger than any array of a chunk


class StereoProcesses:
    """`FastStereo` for a batch of cameras whose state lives in processes; the images are the same, to the bit.

    Args:
        terrain: see `FastStereo`, as the four that follow.
        config: see there.
        mount: see there.
        legs: see there.
        rows: see there.
        columns: see there.
        count: of cameras.
        rng: for their randomness.
        processes: at most as many as there are chunks of cameras.
    """

    def __init__(
        self,
        terrain: Terrain,
        config: StereoConfig | None = None,
        mount: Mount | None = None,
        *,
        legs: bool = True,
        rows: int = ROWS,
        columns: int = COLUMNS,
        count: int,
        rng: np.random.Generator,
        processes: int,
    ) -> None:
        cameras = FastStereo(terrain, config, mount, legs=legs, rows=rows, columns=columns)
        state = cameras.init(count, rng)
        borders = np.linspace(0, len(state), min(processes, len(state)) + 1).round().astype(int)
        self._count = count
        self._parts, self._workers = [], []
        # a forked process would inherit the threads of Embree as locks that nobody opens
        context = multiprocessing.get_context("spawn")
        for first, end in pairwise(borders):
            given = terrain, config, mount, legs, rows, columns, state[first:end]
            self._parts.append(slice(first * cameras.chunk, min(end * cameras.chunk, count)))
            self._workers.append(ProcessPoolExecutor(1, mp_context=context, initializer=_begin, initargs=given))

    def step(
        self, base_position: Floats, base_quaternion: Floats, joint_position: Floats, time_s: float
    ) -> NDArray[np.float32]:
        """One exposure of every camera; arguments and result as in `FastStereo.step`.

        Raises:
            SaltusError: a pose is no pose, or a process has ended.
        """
        check_poses(base_position, base_quaternion, joint_position)
        if len(base_position) != self._count:
            raise SaltusError(f"{len(base_position)} poses for {self._count} cameras: give one for each")
        try:
            pending = [
                worker.submit(_expose, base_position[part], base_quaternion[part], joint_position[part], time_s)
                for worker, part in zip(self._workers, self._parts, strict=True)
            ]
            return np.concatenate([images.result() for images in pending])
        except BrokenProcessPool as error:
            raise SaltusError("a process of the stereo cameras has ended: out of memory, or killed") from error

    def close(self) -> None:
        """Ends the processes."""
        for worker in self._workers:
            worker.shutdown()


class _Worker:
    """What a process holds."""

    cameras: FastStereo
    state: FastState


def _begin(
    terrain: Terrain,
    config: StereoConfig | None,
    mount: Mount | None,
    legs: bool,
    rows: int,
    columns: int,
    state: FastState,
) -> None:
    _keep_heap()
    _Worker.cameras = FastStereo(terrain, config, mount, legs=legs, rows=rows, columns=columns)
    _Worker.state = state


def _keep_heap() -> None:
    """Has glibc keep what is freed for the next image, whose arrays are as large.

    Otherwise it gives the end of its heap back and takes it again, as the number of holes has it: the memory of a
    process went up and down by 4 MB, and each page was cleared anew.
    """
    libc = ctypes.CDLL(None)
    for option, size in ((M_TRIM_THRESHOLD, HEAP_BYTES), (M_MMAP_THRESHOLD, ARRAY_BYTES)):
        libc.mallopt(option, size)


def _expose(
    base_position: Floats, base_quaternion: Floats, joint_position: Floats, time_s: float
) -> NDArray[np.float32]:
    poses = base_position, base_quaternion, joint_position
    images, _Worker.state = _Worker.cameras.step(*poses, time_s, _Worker.state)
    return images
