"""The example of docs/scan.md runs, and its network tells flat ground within its half-widths."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from saltus.heightmap.scan.elevation import Pose

PAGE = Path(__file__).parents[3] / "docs" / "scan.md"


def test_the_example_tells_flat_ground() -> None:
    found = re.search(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    assert found is not None
    flat = np.random.default_rng(0).uniform(-1.1, 1.1, (1, 8000, 3)).astype(np.float32)
    flat[..., 2] = -0.3
    position, rotation = np.array([[0.0, 0.0, 0.3]], np.float32), np.eye(3, dtype=np.float32)[None]
    names: dict[str, Any] = {
        "points": flat, "depth": np.full(flat.shape[:2], 0.6, np.float32), "position": position,
        "rotation": rotation, "now": Pose(position, rotation), "yaw": 0.2,
        "feet": np.zeros((1, 4, 3), np.float32), "standing": np.zeros((1, 4), bool),
    }  # fmt: skip
    code = found.group(1).replace('Path("models', f'Path("{PAGE.parents[1]}/models')
    exec(compile(code, str(PAGE), "exec"), names)  # noqa: S102
    error = np.abs(names["height"] + 0.3)
    assert error.mean() < 0.005
    assert (error <= names["half_width"]).mean() > 0.9
