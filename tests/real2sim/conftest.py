"""What several files of this folder read."""

from pathlib import Path

import pytest
from moving_robot import jumping_log

from saltus.recordings.run_log import RunLog


@pytest.fixture(scope="session")
def jumps(tmp_path_factory: pytest.TempPathFactory) -> tuple[RunLog, Path]:
    """The log of a run onto a step, and its recording."""
    folder = tmp_path_factory.mktemp("jumps")
    return jumping_log(folder), folder / "recording.mcap"
