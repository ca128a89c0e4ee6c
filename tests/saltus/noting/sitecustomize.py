"""Loaded by every process of a command that test_required_packages starts:
notes calls of functions of packages.

NOTED names functions as {module: attribute}. The first call of each that returns writes a file into
the folder NOTES, named after the module, with the innermost file of the project that called it.
After that of the module LAST the process ends, as the rest of its command shows nothing more.
"""

import json
import os
import sys
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType

NOTED = json.loads(os.environ["NOTED"])
NOTES, PROJECT, LAST = (os.environ[name] for name in ("NOTES", "PROJECT", "LAST"))


class Finder:
    """Finds modules as Python does, and has functions noted once they are loaded."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """As importlib asks for it."""
        spec = PathFinder.find_spec(name, path, target) if name in NOTED else None
        if spec is None or spec.loader is None:
            return None
        load = spec.loader.exec_module

        def exec_module(module: ModuleType) -> None:
            load(module)
            note_first_call(module, NOTED[name])

        spec.loader.exec_module = exec_module  # type: ignore[method-assign]
        return spec


def of_the_project(file: str) -> bool:
    """Whether a file is the project's own; its virtual environment may lie in its folder."""
    return file.startswith(PROJECT) and "site-packages" not in file


def note_first_call(module: ModuleType, attribute: str) -> None:
    """Puts a function in the place of another that notes its first call,
    and then puts that one back.
    """
    *parents, name = attribute.split(".")
    owner = module
    for parent in parents:
        owner = getattr(owner, parent)
    real = getattr(owner, name)

    def noting(*arguments: object, **options: object) -> object:
        result = real(*arguments, **options)
        setattr(owner, name, real)
        frame = sys._getframe(1)
        while frame.f_back is not None and not of_the_project(frame.f_code.co_filename):
            frame = frame.f_back
        (Path(NOTES) / module.__name__).write_text(frame.f_code.co_filename)
        if module.__name__ == LAST:
            os._exit(0)
        return result

    setattr(owner, name, noting)


sys.meta_path.insert(0, Finder)  # type: ignore[arg-type]
