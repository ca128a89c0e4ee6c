"""A scan beside the line in a running stack: both are published, watched and recorded."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks._kills import ON_FLAT_GROUND
from saltus.grid import LINE, SCAN
from saltus.recordings.recording import read_recording
from saltus.runtime.programs import PROGRAMS, scan_program
from saltus.runtime.stack import Stack
from saltus.watch.live import LiveRun
from saltus.watch.source import RecordedRun
from saltus.wire.messages import Heightmap, HeightmapStatus

RUN_S = 3.0  # it stands for a second, and then bounds
SEEN_M = 0.017
"""The network's error on all kinds of ground where seen (docs/scan.md)."""
SHARE = 0.5
"""Share of the states that must be answered: on a busy computer some are too old to be."""


@pytest.mark.slow
def test_a_stack_tells_the_line_and_the_scan(speed: float, tmp_path: Path) -> None:
    run = replace(ON_FLAT_GROUND, speed=speed)
    with Stack(run, tmp_path, (scan_program("scan"), *PROGRAMS)) as stack:
        with LiveRun(tmp_path, stack.endpoint) as live:
            scene = live.now()
            while stack.wait(0.1) is False and (scene.scan is None or scene.time_s < RUN_S):
                scene = live.now()
        assert scene.scan is not None
        assert scene.heights is not None
        assert (scene.scan.shape, scene.heights.shape) == (SCAN.shape, LINE.shape)
    recording = read_recording(stack.recording)
    assert recording.complete, recording.lost
    assert not any(stack.restarts.values())
    states = sum(1 for _ in recording.messages("controller/state"))
    for topic, grid in (("heightmap/heightmap", LINE), ("scan/heightmap", SCAN)):
        heard = [m for _, _, m in recording.messages(topic) if isinstance(m, Heightmap)]
        assert len(heard) > SHARE * states
        assert {m.height.shape for m in heard} == {(grid.size,)}
    scans = [m for m in heard if m.status == HeightmapStatus.OK]
    base = {
        m.time_ns: float(m.position_base_in_world[2])  # type: ignore[union-attr]
        for _, _, m in recording.messages("plant/truth")
    }
    errors = [
        np.abs(m.height + base[m.time_ns])[np.isfinite(m.age_s)] for m in scans if m.time_ns in base
    ]
    assert np.concatenate(errors).mean() < SEEN_M  # level ground lies at 0
    watched = RecordedRun(recording)
    assert any(
        (shown := watched.at(t).scan) is not None and shown.shape == SCAN.shape
        for t in np.linspace(0.5, watched.duration_s, 5)
    )
