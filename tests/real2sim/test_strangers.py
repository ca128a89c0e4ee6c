"""Every file of a stranger is read rightly, or refused by one line that names the cure.

Soon, and in little memory.
"""

import re
import shutil
import time
import tracemalloc
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import rosbags.rosbag1.reader
import tomli_w
from strangers import FILES, Stranger
from strangers.bags import Bag, Images, later, write
from strangers.stranger import described, truth

from saltus.cli.main import main
from saltus.recordings.rosbag import read_rosbag
from saltus.recordings.run_log import RunLog, read_run_log

SOON_S = 5.0  # of a processor


def _plain(value: object) -> object:
    """A description as TOML has it: without what is not said."""
    if isinstance(value, dict):
        return {
            key: _plain(inner) for key, inner in value.items() if inner is not None and inner != {}
        }
    return list(value) if isinstance(value, tuple) else value


@pytest.mark.sample(93)
@pytest.mark.parametrize("stranger", FILES, ids=lambda stranger: stranger.name)
def test_a_file_is_read_rightly_or_refused_with_its_cure(
    stranger: Stranger, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = stranger.write(tmp_path)
    (tmp_path / "mine.toml").write_text(
        tomli_w.dumps(_plain(asdict(stranger.description))), encoding="utf-8"
    )
    out, before_s = tmp_path / "log", time.process_time()
    code = main(
        [
            "real2sim",
            "import",
            str(path),
            "--description",
            str(tmp_path / "mine.toml"),
            "--out",
            str(out),
        ]
    )
    told = capsys.readouterr()
    assert time.process_time() - before_s < SOON_S
    if stranger.check is None:
        assert (code, told.out) == (2, "")
        assert told.err.count("\n") == 1
        assert told.err.startswith("saltus: ")
        assert len(told.err) < 600
        assert re.search(stranger.says, told.err), told.err
        assert not out.exists()
    else:
        assert code == 0, told.err
        assert re.search(stranger.says, told.out), told.out
        first = next(line for line in told.out.splitlines() if line.startswith(str(out)))
        stranger.check(read_run_log(Path(first)))


def test_each_chunk_of_a_bag_is_unpacked_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where messages of several chunks alternate,
    as in a bag whose topics were written one after the other.
    """
    unpack, unpacked = rosbags.rosbag1.reader.decompressors["bz2"], list[int]()

    def counted(data: bytes) -> bytes:
        unpacked.append(hash(data))
        return unpack(data)

    monkeypatch.setitem(rosbags.rosbag1.reader.decompressors, "bz2", counted)
    path = write(Bag(kind="ros1", compression="BZ2", chunk_bytes=20_000), tmp_path)
    read_rosbag(path, described().topics)
    assert len(unpacked) > 10
    assert len(set(unpacked)) == len(unpacked)


def _many(log: RunLog) -> RunLog:
    """Five hundred images of 160x120, 19 MB."""
    depth = truth().depth
    assert depth is not None
    times = log.joints.time_s[0] + np.linspace(0.0, 0.25, 500)
    image = np.kron(depth.depth_mm[0], np.ones((3, 3), np.uint16))[:120, :160]
    shown = np.broadcast_to(image, (500, 120, 160))
    return replace(
        log, depth=replace(depth, arrival_s=times + 0.05, capture_s=times, depth_mm=shown)
    )


def test_images_are_held_twice_at_most(tmp_path: Path) -> None:
    path = write(Bag(kind="mcap", change=_many, images=(Images(info_size=(160, 120)),)), tmp_path)
    tracemalloc.start()
    log, _ = read_rosbag(path, described().topics)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert log.depth is not None
    assert log.depth.depth_mm.shape == (500, 120, 160)
    assert peak < 2.5 * log.depth.depth_mm.nbytes


def test_parts_of_a_recording_without_metadata_are_one_log(tmp_path: Path) -> None:
    """As a recorder splits it; the second part begins where the first one ends."""
    (tmp_path / "parts").mkdir()
    whole = later(truth(), 1e9)
    for number, rows in enumerate((slice(0, 60), slice(60, None))):
        folder = tmp_path / f"{number}"
        folder.mkdir()
        bag = Bag(start_s=0.0, images=(), change=lambda _, rows=rows: _cut(whole, rows))
        shutil.move(write(bag, folder) / "run.mcap", tmp_path / "parts" / f"run_{number}.mcap")
    log, _ = read_rosbag(tmp_path / "parts", described().topics)
    order = [log.meta["joints"].index(f"{joint}_joint") for joint in whole.meta["joints"]]
    np.testing.assert_allclose(log.joints.q[:, order], truth().joints.q, rtol=0, atol=1e-9)


def _cut(log: RunLog, rows: slice) -> RunLog:
    signals = {
        name: values[rows] for name, values in vars(log.joints).items() if values is not None
    }
    return replace(log, joints=replace(log.joints, **signals), imu=None, base=None)
