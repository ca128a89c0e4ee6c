"""What tests of this folder share."""

from collections.abc import Iterator

import pytest
from bus_ends import RUN
from recorded import run_samples, write

from saltus.recordings import recorder
from saltus.recordings.recording import Recording
from saltus.wire.router import open_router


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    endpoint, router = open_router(speed=RUN.link_speed)
    yield endpoint
    router.close()


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    patch = pytest.MonkeyPatch()
    patch.setattr(recorder, "CHUNK_BYTES", 16 * 1024)  # many chunks in a short run
    path = tmp_path_factory.mktemp("recording") / "recording.mcap"
    recording = write(path, list(run_samples()))
    patch.undo()
    return recording
