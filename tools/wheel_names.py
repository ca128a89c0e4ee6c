"""Checks that wheels hold every module once, under one top-level name:
wheel_names.py CHECKOUT WHEEL ...
"""

import sys
import zipfile
from pathlib import Path

ROOMS = ("heightmap", "render", "policy", "controller", "real2sim")


def modules(checkout: Path) -> set[str]:
    """Paths of all modules, as they are to be in a wheel."""
    kernel = {
        path
        for path in (checkout / "saltus").rglob("*.py")
        if path.relative_to(checkout).parts[1] not in ROOMS
    }
    paths = {str(path.relative_to(checkout)) for path in kernel}
    for room in ROOMS:
        paths |= {
            f"saltus/{path.relative_to(checkout)}" for path in (checkout / room).rglob("*.py")
        }
    return paths


def faults(wheel: Path, expected: set[str]) -> list[str]:
    """Faults of a wheel, in words."""
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names if ".dist-info/" not in name}
    held = {name for name in names if name.endswith(".py") and not name.startswith("saltus/data/")}
    found = [] if tops == {"saltus"} else [f"top-level names {sorted(tops)}, not saltus alone"]
    found += [f"{name} is missing" for name in sorted(expected - held)]
    found += [f"{name} is not of the checkout" for name in sorted(held - expected)]
    found += (
        []
        if "saltus/py.typed" in names
        else ["saltus/py.typed is missing: types of the API are not seen"]
    )
    found += [
        f"{name} is there twice"
        for name in sorted({name for name in names if names.count(name) > 1})
    ]
    return found


if __name__ == "__main__":
    expected = modules(Path(sys.argv[1]))
    for wheel in map(Path, sys.argv[2:]):
        if found := faults(wheel, expected):
            sys.exit("\n".join((f"{wheel}:", *found)))
        sys.stdout.write(f"{wheel.parent.name}: {len(expected)} modules, one top-level name\n")
