"""Writes service.txt: what an installation needs that only serves heights,
and of that what the packages need in turn.

python tools/service.py          # a test fails where the file is not what this writes

`pip install --no-deps saltus -r service.txt` looks for nothing else, so the list must be whole.
"""

import tomllib
from importlib.metadata import requires, version
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "service.txt"
NEEDED = (
    "array-api-compat",
    "eclipse-zenoh",
    "mujoco",
    "numpy",
    "onnxruntime",
    "rosbags",
    "tomli-w",
    "tyro",
)
"""Packages of Saltus's own dependencies that are needed. MuJoCo reads the robot's model for `saltus
router`; the service itself does without."""
LEFT_OUT = ("glfw", "mujoco-studio", "pyopengl")
"""Needed by MuJoCo, for what nobody asks of it here: windows."""
HEAD = """\
# What `saltus router` and `saltus heightmap serve` need, made by tools/service.py:
#     pip install --no-deps saltus -r service.txt
"""


def service_requirements() -> list[str]:
    """The lines of the file: names with the bounds that Saltus sets,
    or the package that needs them.

    Who wants one version of another package is named by its own version, too: they come as a pair.
    """
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"][
        "dependencies"
    ]
    waiting = [
        each for each in map(Requirement, declared) if canonicalize_name(each.name) in NEEDED
    ]
    found: dict[str, str] = {}
    while waiting:
        each = waiting.pop(0)
        name = canonicalize_name(each.name)
        if name in found or name in LEFT_OUT:
            continue
        wanted = [need for need in map(Requirement, requires(name) or ()) if _is_needed(need)]
        is_pair = any(bound.operator == "==" for need in wanted for bound in need.specifier)
        found[name] = f"{name}=={version(name)}" if is_pair else f"{name}{each.specifier}"
        waiting += wanted
    return sorted(found.values())


def _is_needed(need: Requirement) -> bool:
    return need.marker is None or need.marker.evaluate({"extra": ""})


if __name__ == "__main__":
    FILE.write_text(HEAD + "\n".join(service_requirements()) + "\n", encoding="utf-8")
