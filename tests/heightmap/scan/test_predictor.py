"""The deployed predictor tells what training computed, and refuses files of another kind."""

import json

import numpy as np
import onnx
import pytest
import torch

from saltus.errors import ModelError
from saltus.grid import SCAN, HeightGrid
from saltus.heightmap.scan.cells import fine_cell_positions, sample_bilinear
from saltus.heightmap.scan.elevation import MapUpdate, OdometryPoses, new_map
from saltus.heightmap.scan.network_inputs import remember_told
from saltus.heightmap.scan.predictor import ScanNetwork, ScanPredictor
from saltus.heightmap.scan.training.examples import with_image
from saltus.heightmap.scan.training.export import export_scan
from saltus.heightmap.scan.training.flights import next_image
from saltus.heightmap.scan.training.scan_model import ScanModel, told_heights
from saltus.used_networks import model_path

GRID = HeightGrid(x=(-0.2, -0.1, 0.0, 0.1, 0.2), y=(-0.1, 0.0, 0.1))


@pytest.fixture
def exported(small, tmp_path):
    torch.manual_seed(1)
    model = ScanModel(small.network, small.map).eval()
    path = tmp_path / "scan.onnx"
    export_scan(model, small, path)
    return model, path


def alone(measured):
    """The first robot of a batch, in numpy."""

    def one(value):
        return (
            OdometryPoses(*map(one, value))
            if isinstance(value, OdometryPoses)
            else value[:1].numpy()
        )

    return MapUpdate(*map(one, measured))


def test_it_tells_what_training_computes(small, exported, fly, draws):
    model, path = exported
    flight, settings = fly(1, errors=1.0, odometry=(1.0, 1.0), feet=1.0)
    state = new_map(1, small.map, flight.ground.height)
    predictor = ScanPredictor(ScanNetwork(path))
    for _ in range(4):
        shot = next_image(flight, settings, draws)
        state, inputs, around = with_image(state, shot.measured, shot.now_s, small.map)
        with torch.no_grad():
            heights = told_heights(model, inputs, around.filled)
        state = remember_told(state, heights)
        predictor.see(alone(shot.measured), float(shot.now_s))
    pose, yaw = alone(shot.measured).now, float(shot.believed_yaw)
    height, half_width = predictor.heights(pose, yaw, GRID)
    place = np.stack(GRID.points_in_world(around.base[0, :2].double().numpy(), np.asarray(yaw)), -1)
    at = fine_cell_positions(torch.from_numpy(place)[None].float(), state.corner, small.map)
    expected = sample_bilinear(heights.height, at)[0] - around.base[0, 2]
    # a point on the border of two cells may fall into either
    assert np.median(np.abs(height - expected.numpy())) < 1e-4
    assert np.median(np.abs(half_width - sample_bilinear(heights.half_width, at)[0].numpy())) < 1e-4
    assert predictor.images == 4


def test_it_knows_nothing_before_an_image_and_after_a_reset(exported, fly, draws):
    predictor = ScanPredictor(ScanNetwork(exported[1]))
    flight, settings = fly(1)
    shot = next_image(flight, settings, draws)
    measured = alone(shot.measured)
    predictor.see(measured, float(shot.now_s))
    predictor.heights(measured.now, 0.0, GRID)
    predictor.reset()
    with pytest.raises(ModelError, match="no image"):
        predictor.heights(measured.now, 0.0, GRID)


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("format", "saltus heights 9", "format"),
        ("measured", ["known"], "measured"),
        ("map", "cells = 0", "cells"),
    ],
)
def test_a_file_that_does_not_fit_is_refused_by_name(exported, field, value, said):
    path = exported[1]
    file = onnx.load(path)
    for entry in file.metadata_props:
        if entry.key == field:
            entry.value = json.dumps(value)
    onnx.save(file, path)
    path.with_name(path.name + ".sha256").unlink()
    with pytest.raises(ModelError, match=said):
        ScanNetwork(path)


@pytest.mark.parametrize("field", ["odometry_error", "mount_error"])
@pytest.mark.parametrize("family", ["flat", "rubble"])
def test_the_shipped_network_is_surer_where_odometry_and_mount_are_known_better(
    fly, draws, family, field
):
    """On the same images, half-widths of seen points grow with the error that is told."""
    flight, settings = fly(
        1, families=(family,), rows=36, columns=48, images=30, feet=1.0, height_m=(0.3, 0.5),
        down_deg=(30.0, 50.0),
    )  # fmt: skip
    shots = [next_image(flight, settings, draws) for _ in range(12)]
    network, widths = ScanNetwork(model_path("scan")), []
    for error in (0.0, 1.0, 2.0):
        predictor, given = ScanPredictor(network), {field: np.full(1, error, np.float32)}
        for shot in shots:
            predictor.see(alone(shot.measured)._replace(**given), float(shot.now_s))
        ground = predictor.ground(alone(shot.measured).now, float(shot.believed_yaw), SCAN)
        widths.append(np.median(ground.half_width[np.isfinite(ground.seen_s)]))
    assert 1.1 * widths[0] < widths[1]
    assert 1.1 * widths[1] < widths[2]
