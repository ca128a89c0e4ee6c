"""The example of docs/scan.md runs as it is printed,
and tells flat ground within its half-widths.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

PAGE = Path(__file__).parents[3] / "docs" / "scan.md"


def test_the_example_tells_flat_ground(monkeypatch: pytest.MonkeyPatch) -> None:
    found = re.search(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    assert found is not None
    monkeypatch.chdir(PAGE.parents[1])
    names: dict[str, Any] = {}
    exec(compile(found.group(1), str(PAGE), "exec"), names)  # noqa: S102
    error = np.abs(names["height"] + 0.3)
    assert error.mean() < 0.005
    assert (error <= names["half_width"]).mean() > 0.9
