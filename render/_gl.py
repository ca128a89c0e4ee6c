"""Makes pyrender render on OSMesa, or on EGL where OSMesa is gone,
with what its own requirements install.

pyrender 0.1.45 demands PyOpenGL 3.1.0, which lacks the OSMesa calls that pyrender makes. And every
PyOpenGL wraps the current context in a new pointer object at each question, although it keeps
tables by context: the tables are asked for again at every call and never freed, a quarter of a
megabyte a frame. Both are mended here at run time, for PyOpenGL 3.1.0 as for later ones, and
nothing is changed before `load_pyrender` is called.
"""

import ctypes
import ctypes.util
import importlib
import os
import warnings
from types import ModuleType
from typing import Any

from saltus.errors import SaltusError

# osmesa.h of Mesa 12 and later
_ATTRIBUTES = {
    "OSMESA_DEPTH_BITS": 0x30,
    "OSMESA_STENCIL_BITS": 0x31,
    "OSMESA_ACCUM_BITS": 0x32,
    "OSMESA_PROFILE": 0x33,
    "OSMESA_CORE_PROFILE": 0x34,
    "OSMESA_COMPAT_PROFILE": 0x35,
    "OSMESA_CONTEXT_MAJOR_VERSION": 0x36,
    "OSMESA_CONTEXT_MINOR_VERSION": 0x37,
}


# Platform of PyOpenGL: the library that it needs, and that library's name for the question which
# context is current
_PLATFORMS = {
    "osmesa": ("OSMesa", "OSMesaGetCurrentContext"),
    "egl": ("EGL", "eglGetCurrentContext"),
}


def load_pyrender() -> ModuleType:
    """Imports pyrender; may be called again.

    Raises:
        SaltusError: neither OSMesa nor EGL is installed, or this process already uses OpenGL on
            another platform.
    """
    platform = gl_platform()
    try:
        with warnings.catch_warnings():
            # Deprecations inside PyOpenGL and pyrender, not ours to mend
            warnings.simplefilter("ignore")
            _mend(importlib.import_module("OpenGL.platform"), platform)
            return importlib.import_module("pyrender")
    except (ImportError, AttributeError) as error:
        raise SaltusError(
            f"pyrender cannot load {_PLATFORMS[platform][0]} ({error}): 'apt install libosmesa6 "
            "libxrender1', "
            "or use the embree renderer"
        ) from error


def gl_platform() -> str:
    """Where pyrender draws: "osmesa" or "egl".

    What the environment says, else what is installed, OSMesa first.

    Written to the environment, where PyOpenGL and pyrender look.

    Raises:
        SaltusError: the environment names another.
    """
    found = next(
        (name for name, (library, _) in _PLATFORMS.items() if ctypes.util.find_library(library)),
        "osmesa",
    )
    platform = os.environ.get("PYOPENGL_PLATFORM") or found
    if platform not in _PLATFORMS:
        raise SaltusError(
            f"PYOPENGL_PLATFORM is '{platform}': the pyrender back end needs 'osmesa' or 'egl', or "
            "not set at all"
        )
    os.environ["PYOPENGL_PLATFORM"] = platform
    return platform


def _mend(opengl: Any, platform: str) -> None:
    attribute, question = _PLATFORMS[platform]
    library = getattr(opengl.PLATFORM, attribute)
    if platform == "osmesa":
        _add_missing(importlib.import_module("OpenGL.osmesa"), library)
    current = library[question]  # a function object of our own: MuJoCo uses the shared one
    current.restype = ctypes.c_void_p  # an address: equal from call to call, as a key must be

    def current_context() -> object:
        return current()

    opengl.PLATFORM.GetCurrentContext = opengl.GetCurrentContext = current_context
    contextdata = importlib.import_module("OpenGL.contextdata")
    contextdata.getContext = lambda context=None: current() if context is None else context  # type: ignore[attr-defined]


def _add_missing(osmesa: ModuleType, library: ctypes.CDLL) -> None:
    """Adds to PyOpenGL 3.1.0 what later versions have."""
    if "OSMesaCreateContextAttribs" in vars(osmesa):
        return
    create = library.OSMesaCreateContextAttribs
    create.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
    create.restype = vars(osmesa)["OSMesaContext"]

    def create_context(attributes: object, share: object) -> object:
        """OSMesaCreateContextAttribs for a ctypes array of int that ends with 0."""
        return create(attributes, share)

    vars(osmesa).update(_ATTRIBUTES, OSMesaCreateContextAttribs=create_context)
