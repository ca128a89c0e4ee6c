"""Heights in two dimensions are a net, whose colours say how sure each point is.

A line stays a curve.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded import LATENCY_NS, run_messages
from samples import ROBOT

from saltus.config import RunConfig
from saltus.depth_camera import load_camera
from saltus.grid import LINE, SCAN, HeightGrid
from saltus.recordings.recording import RecordedMessage
from saltus.terrain import flat
from saltus.watch.drawing import GUESS_M, GUESSED, Drawing
from saltus.watch.pictures import PREDICTED, heightmap_curves
from saltus.watch.scene import Scene, SceneMaker, SceneWorld
from saltus.watch.server import PageServer
from saltus.wire import codec
from saltus.wire.codec import Envelope

WORLD = SceneWorld(
    title="",
    config=RunConfig(robot="go1", grid="line"),
    robot=ROBOT,
    terrain=flat.make(),
    camera=load_camera("ideal"),
)


def scene_of(grid: HeightGrid, half_width: np.ndarray) -> Scene:
    sent: Any = dict(run_messages(3))
    x, y = grid.points.T
    heights = replace(
        sent["heightmap/heightmap"], x=np.array(grid.x), y=np.array(grid.y),
        height=0.1 * x + 0.01 * y,
        half_width_90=half_width,
    )  # fmt: skip
    arrivals = [
        RecordedMessage(
            message.time_ns + LATENCY_NS,
            key,
            Envelope(1, message.time_ns, bytes(16)),
            codec.encode_message(message),
        )
        for key, message in {
            "controller/state": sent["controller/state"],
            "heightmap/heightmap": heights,
        }.items()
    ]
    return SceneMaker(WORLD).make(arrivals, heights.time_ns + LATENCY_NS, ())


@pytest.fixture
def drawing() -> Iterator[Drawing]:
    server = PageServer(0)
    yield Drawing(server, 0, WORLD, 0.0)
    server.stop()


def test_a_scan_is_a_net_and_a_line_a_curve_in_any_order(drawing: Drawing) -> None:
    for grid in (LINE, SCAN, LINE):
        drawing.draw(scene_of(grid, np.full(grid.size, 0.02)), np.zeros(3))
        rows, columns = grid.shape
        assert drawing._predicted.points.shape == (
            (rows - 1) * columns + rows * (columns - 1),
            2,
            3,
        )
        assert drawing._widths.visible == (columns == 1)


def test_a_guess_has_the_colour_of_guesses(drawing: Drawing) -> None:
    drawing.draw(
        scene_of(SCAN, np.where(SCAN.points[:, 0] > 0.05, 2.0 * GUESS_M, 0.0)), np.zeros(3)
    )
    colours = drawing._predicted.colors
    assert colours.shape == drawing._predicted.points.shape
    assert {tuple(colour) for colour in colours.reshape(-1, 3).tolist()} == {PREDICTED, GUESSED}


def test_a_plot_of_a_scan_is_its_middle(tmp_path: Path) -> None:
    scene = scene_of(SCAN, np.full(SCAN.size, 0.02))
    assert scene.heights is not None
    x, low, high, predicted, _ = heightmap_curves(scene.heights, scene)
    np.testing.assert_allclose(x, SCAN.x)
    np.testing.assert_allclose(high - low, 0.04)
    np.testing.assert_allclose(predicted - predicted[0], 0.1 * (x - x[0]), atol=1e-9)


def test_a_scan_beside_the_line_is_a_net_of_its_own(drawing: Drawing) -> None:
    line, scan = (scene_of(grid, np.full(grid.size, 0.02)) for grid in (LINE, SCAN))
    both = replace(line, scan=scan.heights)
    drawing.draw(scan, np.zeros(3))
    net = drawing._predicted.points
    assert not drawing._scan.visible
    drawing.draw(both, np.zeros(3))
    np.testing.assert_array_equal(drawing._scan.points, net)
    assert drawing._scan.visible
    assert drawing._predicted.points.shape == (LINE.size - 1, 2, 3)
    drawing.draw(line, np.zeros(3))
    assert not drawing._scan.visible
