"""The notebooks of the documentation: they run, and say and draw what their files hold."""

import base64
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
MOST_BYTES = 300_000
"""Of a file in the repository: each change of a picture stays in its history."""


def cells(notebook: Path) -> list[dict[str, Any]]:
    read: list[dict[str, Any]] = json.loads(notebook.read_text())["cells"]
    return read


def outputs(notebook: Path) -> list[list[str]]:
    """What each cell gives, in order: text, whose numbers may differ from computer to computer,
    and pictures.
    """
    number = r" *[-+]?\d+(\.\d+)?(e[-+]?\d+)?"
    return [
        [
            re.sub(number, "#", "".join(each["text"])) if "text" in each else "a picture"
            for each in cell["outputs"]
        ]
        for cell in cells(notebook)
        if cell["cell_type"] == "code"
    ]


def pictures(notebook: Path) -> list[np.ndarray]:
    given = [each for cell in cells(notebook) for each in cell.get("outputs", ())]
    found = [each["data"]["image/png"] for each in given if "data" in each]
    return [
        cv2.imdecode(np.frombuffer(base64.b64decode(each), np.uint8), cv2.IMREAD_GRAYSCALE)
        for each in found
    ]


def test_there_are_three() -> None:
    assert [path.stem for path in NOTEBOOKS] == ["effects", "heights", "policy"]


@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_gives_what_its_file_holds(notebook: Path, tmp_path: Path) -> None:
    tool = [
        sys.executable,
        "-W",
        "error",
        str(ROOT / "tools" / "notebooks.py"),
        str(notebook),
        "--out",
        str(tmp_path),
    ]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}  # what cells write goes there
    subprocess.run(tool, env=environment, check=True)
    made = tmp_path / notebook.name
    assert [cell["source"] for cell in cells(made)] == [cell["source"] for cell in cells(notebook)]
    assert outputs(made) == outputs(notebook), "run python tools/notebooks.py"
    drawn, held = pictures(made), pictures(notebook)
    assert len(drawn) >= 2
    for new, old in zip(drawn, held, strict=True):
        assert new.std() > 10.0  # grey levels: not a blank page
        assert new.shape == old.shape
    assert notebook.stat().st_size < MOST_BYTES
