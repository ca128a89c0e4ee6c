"""MuJoCo's drawings without a screen, in software, in whatever process asks for them.

MuJoCo's own Python class for this decides when it is imported which library draws, and leans on
PyOpenGL, whose version that pyrender pins fails when the context is freed. Both are avoided by
talking to OSMesa directly.
"""

import ctypes
import ctypes.util
import os
from collections.abc import Iterator
from contextlib import contextmanager

import mujoco
import numpy as np
from numpy.typing import NDArray

from saltus.errors import SaltusError

# osmesa.h and gl.h
_RGBA, _UNSIGNED_BYTE, _DEPTH_BITS, _STENCIL_BITS = 0x1908, 0x1401, 24, 8


@contextmanager
def drawing_context(model: mujoco.MjModel, width: int, height: int) -> Iterator[mujoco.MjrContext]:
    """A drawing context of its own for `model`, current in this thread while the block lasts.

    Args:
        model: Its off-screen buffer is made `width` x `height` pixels.
        width: Of the pictures [px].
        height: Of the pictures [px].

    Raises:
        SaltusError: OSMesa is not installed or refuses.
    """
    library = _load()
    canvas = np.zeros((height, width, 4), dtype=np.uint8)
    handle = library.OSMesaCreateContextExt(_RGBA, _DEPTH_BITS, _STENCIL_BITS, 0, None)
    if not handle or not library.OSMesaMakeCurrent(
        handle, canvas.ctypes.data, _UNSIGNED_BYTE, width, height
    ):
        raise SaltusError(
            "OSMesa cannot make a drawing context: reinstall it with 'apt install libosmesa6'"
        )
    try:
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        with _told_to_use_osmesa():
            context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        try:
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
            yield context
        finally:
            context.free()  # while OpenGL can still be asked to
    finally:
        library.OSMesaMakeCurrent(None, None, 0, 0, 0)
        library.OSMesaDestroyContext(handle)


def read_pixels(context: mujoco.MjrContext, width: int, height: int) -> NDArray[np.uint8]:
    """The picture that was drawn, first row on top, shape (height, width, 3)."""
    picture = np.empty((height, width, 3), dtype=np.uint8)
    mujoco.mjr_readPixels(picture, None, mujoco.MjrRect(0, 0, width, height), context)
    return np.ascontiguousarray(picture[::-1])


def _load() -> ctypes.CDLL:
    name = ctypes.util.find_library("OSMesa")
    if name is None:
        raise SaltusError(
            "the video needs OSMesa: 'apt install libosmesa6', or run with --no-video"
        )
    library = ctypes.CDLL(name, mode=ctypes.RTLD_GLOBAL)
    library.OSMesaCreateContextExt.restype = ctypes.c_void_p
    library.OSMesaCreateContextExt.argtypes = [ctypes.c_uint, *[ctypes.c_int] * 3, ctypes.c_void_p]
    library.OSMesaMakeCurrent.argtypes = [
        ctypes.c_void_p,
        ctypes.c_void_p,
        ctypes.c_uint,
        ctypes.c_int,
        ctypes.c_int,
    ]
    library.OSMesaDestroyContext.argtypes = [ctypes.c_void_p]
    return library


@contextmanager
def _told_to_use_osmesa() -> Iterator[None]:
    """The engine asks the environment where to find OpenGL,
    once, when a drawing context is made.
    """
    before = os.environ.get("MUJOCO_GL")
    os.environ["MUJOCO_GL"] = "osmesa"
    try:
        yield
    finally:
        if before is None:
            del os.environ["MUJOCO_GL"]
        else:
            os.environ["MUJOCO_GL"] = before
