from pathlib import Path

import cv2
import numpy as np
import pytest

from render.preview import VIEWS, contact_sheet, write_preview
from saltus.config import TerrainConfig
from saltus.errors import SaltusError
from saltus.terrain.curriculum import make_terrain

TERRAIN = make_terrain(TerrainConfig(terrain="gap", difficulty=0.3))


def test_a_sheet_has_a_row_for_every_view(tmp_path: Path) -> None:
    sheet = cv2.imread(str(write_preview(TERRAIN, tmp_path / "sheet.png")))
    assert sheet is not None
    assert sheet.shape[0] % len(VIEWS) == 0
    assert sheet.shape[0] > len(VIEWS) * 240
    rows = np.split(sheet, len(VIEWS))
    assert all(len(np.unique(row.reshape(-1, 3), axis=0)) > 20 for row in rows)  # there is something to see


def test_nothing_is_grey_and_near_is_red() -> None:
    wide, narrow = np.full((240, 424), np.inf, dtype=np.float32), np.full((48, 16), 0.1, dtype=np.float32)
    sheet = contact_sheet([("title", wide, narrow)])
    blue, green, red = sheet[150, 200]
    assert blue == green == red
    blue, green, red = sheet[150, 490]
    assert red > 100 > max(green, blue)


def test_a_folder_that_is_missing(tmp_path: Path) -> None:
    with pytest.raises(SaltusError, match=r"sheet\.png"):
        write_preview(TERRAIN, tmp_path / "missing" / "sheet.png")
