"""Makes pyrender render on OSMesa with what its own requirements install.

pyrender 0.1.45 demands PyOpenGL 3.1.0, which lacks the OSMesa calls that pyrender makes. And every PyOpenGL wraps the
current OSMesa context in a new pointer object at each question, although it keeps tables by context: the tables are
asked for again at every call and never freed, a quarter of a megabyte a frame. Both are mended here at run time, for
PyOpenGL 3.1.0 as for later ones, and nothing is changed before `load_pyrender` is called.
"""

import ctypes
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


def load_pyrender() -> ModuleType:
    """Imports pyrender for OSMesa; may be called again.

    Raises:
        SaltusError: OSMesa is not installed, or this process already uses OpenGL on another platform.
    """
    platform = os.environ.setdefault("PYOPENGL_PLATFORM", "osmesa")
    if platform != "osmesa":
        raise SaltusError(f"PYOPENGL_PLATFORM is '{platform}': the pyrender back end needs 'osmesa', or not set at all")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # deprecations inside PyOpenGL and pyrender, not ours to mend
            _mend(importlib.import_module("OpenGL.platform"))
            return importlib.import_module("pyrender")
    except (ImportError, AttributeError) as error:
        raise SaltusError(
            f"pyrender cannot load OSMesa ({error}): 'apt install libosmesa6', or use the embree renderer"
        ) from error


def _mend(platform: Any) -> None:
    library = platform.PLATFORM.OSMesa
    _add_missing(importlib.import_module("OpenGL.osmesa"), library)
    current = library["OSMesaGetCurrentContext"]  # a function object of our own: MuJoCo uses the shared one
    current.restype = ctypes.c_void_p  # an address: equal from call to call, as a key must be

    def current_context() -> Any:
        return current()

    platform.PLATFORM.GetCurrentContext = platform.GetCurrentContext = current_context
    contextdata = importlib.import_module("OpenGL.contextdata")
    contextdata.getContext = lambda context=None: current() if context is None else context  # type: ignore[attr-defined]


def _add_missing(osmesa: ModuleType, library: Any) -> None:
    """Adds to PyOpenGL 3.1.0 what later versions have."""
    if "OSMesaCreateContextAttribs" in vars(osmesa):
        return
    create = library.OSMesaCreateContextAttribs
    create.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
    create.restype = vars(osmesa)["OSMesaContext"]

    def create_context(attributes: Any, share: Any) -> Any:
        """OSMesaCreateContextAttribs for a ctypes array of int that ends with 0."""
        return create(attributes, share)

    vars(osmesa).update(_ATTRIBUTES, OSMesaCreateContextAttribs=create_context)
