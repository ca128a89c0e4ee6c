"""Loads Open3D without its plots in a browser.

Open3D imports dash and plotly, which take two thirds of the second that it takes to load; and a
camera that has died must be back soon. What they are for stays away from a process that casts rays.
"""

import importlib
import sys
from types import ModuleType

from saltus.errors import SaltusError

PLOTS = "open3d.visualization.draw_plotly"
"""The one module of Open3D that imports them."""


def load_open3d() -> ModuleType:
    """Imports Open3D; may be called again."""
    if "open3d" in sys.modules:
        return importlib.import_module("open3d")
    sys.modules[PLOTS] = _Absent(PLOTS)
    try:
        return importlib.import_module("open3d")
    finally:
        del sys.modules[PLOTS]


class _Absent(ModuleType):
    """Has every name, and none that works."""

    def __getattr__(self, name: str) -> object:
        if name.startswith("__"):
            raise AttributeError(name)

        def refuse(*_: object, **__: object) -> None:
            raise SaltusError(
                f"open3d.visualization.{name} was left out: import open3d before render"
            )

        return refuse
