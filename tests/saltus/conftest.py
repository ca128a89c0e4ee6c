"""What tests of this folder share."""

import pytest
from recorded import run_samples, write

from saltus.recordings import recorder
from saltus.recordings.recording import Recording


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    patch = pytest.MonkeyPatch()
    patch.setattr(recorder, "CHUNK_BYTES", 16 * 1024)  # many chunks in a short run
    path = tmp_path_factory.mktemp("recording") / "recording.mcap"
    recording = write(path, list(run_samples()))
    patch.undo()
    return recording
