"""A training goes on where it was, learns, and its ONNX file tells what the network tells."""

import json
from dataclasses import replace

import numpy as np
import onnxruntime
import pytest
import torch

from saltus.errors import ConfigError, ModelError
from saltus.heightmap.scan.elevation import WIDEST, new_map
from saltus.heightmap.scan.network_inputs import MEASURED, MEMORY, NUMBERS, MapHeights
from saltus.heightmap.scan.settings import MapSettings
from saltus.heightmap.scan.training.card import read_results, scan_card
from saltus.heightmap.scan.training.evaluation import (
    evaluate_scan,
    table_of,
    usual_flights,
    write_results,
)
from saltus.heightmap.scan.training.examples import UpdateCalls, next_example
from saltus.heightmap.scan.training.export import export_scan
from saltus.heightmap.scan.training.files import read_scan_checkpoint
from saltus.heightmap.scan.training.flights import draw_flight
from saltus.heightmap.scan.training.gradient_limits import GradientLimits
from saltus.heightmap.scan.training.scan_model import ScanModel, parameter_count, scan_loss
from saltus.heightmap.scan.training.seeded_random import SeededRandom
from saltus.heightmap.scan.training.settings import (
    FlightSettings,
    NetworkSettings,
    ScanTrainSettings,
)
from saltus.heightmap.scan.training.train import ScanTrainer, train_scan
from saltus.model_file import ModelFile
from saltus.onnx_export import weights_of

CPU = torch.device("cpu")


def test_a_training_that_was_interrupted_is_as_one_that_was_not(small, tmp_path):
    whole = train_scan(small, tmp_path / "whole", updates=6, device=CPU)
    trainer = ScanTrainer(small, CPU)
    trainer.round(0.0, 0.5)
    (tmp_path / "parts").mkdir()
    trainer.save(tmp_path / "parts" / "scan.pt")
    resumed = train_scan(small, tmp_path / "parts", updates=6, device=CPU)
    for one, other in zip(whole.parameters(), resumed.parameters(), strict=True):
        torch.testing.assert_close(one, other, rtol=0.0, atol=0.0)


@pytest.mark.sample(1)
@pytest.mark.parametrize("size", [1e3, float("inf"), float("nan")])
def test_a_burst_moves_weights_by_no_more_than_usual(small, monkeypatch, size):
    """One gradient in seven is of another size, or none:
    nothing grows, and the network stays sound.
    """
    counts = {"updates": 0}

    def bursting(*given):
        counts["updates"] += 1
        return scan_loss(*given) * (size if counts["updates"] % 7 == 6 else 1.0)

    small = replace(small, round=12)
    steady, burst = ScanTrainer(small, CPU), ScanTrainer(small, CPU)
    start = [weight.detach().clone() for weight in steady.model.parameters()]
    steady.round(0.1, 0.2)
    monkeypatch.setattr("saltus.heightmap.scan.training.train.scan_loss", bursting)
    assert burst.round(0.1, 0.2).clipped > 0.1

    def moved(trainer):
        pairs = zip(trainer.model.parameters(), start, strict=True)
        return float(
            torch.stack([(mine.detach() - kept).abs().max() for mine, kept in pairs]).max()
        )

    assert moved(burst) < 2.0 * moved(steady)


def test_a_burst_in_one_layer_is_clipped_by_what_is_usual_of_that_layer(small):
    """Beside the head's gradient it would be small, and no limit of the whole would see it."""
    limits = GradientLimits((trainer := ScanTrainer(small, CPU)).model)
    inner = trainer.model.deep.weight

    def clipped(size):
        for weight in trainer.model.parameters():
            weight.grad = torch.full_like(weight, 1e-3)
        trainer.model.head.weight.grad.fill_(1.0)
        inner.grad.mul_(size)
        share = limits.clip(1e3)
        return share.item(), inner.grad.norm().item()

    before, usual = clipped(1.0)
    burst, limited = clipped(50.0)
    assert before == 0.0 < burst
    assert limited == pytest.approx(2.0 * usual, rel=1e-3)


def test_features_stay_within_their_bound_however_large_weights_are(small):
    settings = replace(small.network, features=4.0)
    unbounded = replace(small.network, features=0.0)
    bounded, free = ScanModel(settings, small.map), ScanModel(unbounded, small.map)
    seen = []
    for model in (bounded, free):
        with torch.no_grad():
            for weight in model.parameters():
                weight.fill_(0.5)
        model.head.register_forward_hook(lambda _, given, _out: seen.append(given[0]))
        side = small.map.side
        model(
            torch.zeros(1, side, side), torch.ones(1, len(MEASURED), side, side),
            torch.ones(1, len(MEMORY), side, side), torch.zeros(1, len(NUMBERS)),
        )  # fmt: skip
    size = [features.square().mean(1).sqrt().max().item() for features in seen]
    assert size[0] == pytest.approx(4.0, rel=1e-3)
    assert size[1] > 1e3


def test_a_checkpoint_of_another_training_is_refused(small, tmp_path):
    trainer = ScanTrainer(small, CPU)
    trainer.save(tmp_path / "scan.pt")
    with pytest.raises(ModelError, match="other settings"):
        train_scan(replace(small, seed=1), tmp_path, updates=1, device=CPU)
    table = torch.load(tmp_path / "scan.pt", weights_only=True)
    table["model"]["stem.weight"] = table["model"]["stem.weight"][:, :-8]
    torch.save(table, tmp_path / "scan.pt")
    with pytest.raises(ModelError, match="other planes"):
        train_scan(small, tmp_path, updates=1, device=CPU)
    (tmp_path / "scan.pt").write_bytes(b"no checkpoint")
    with pytest.raises(ModelError, match="no checkpoint"):
        read_scan_checkpoint(tmp_path / "scan.pt")


def test_a_training_begins_with_an_exported_network(small, tmp_path):
    torch.manual_seed(9)
    model = ScanModel(small.network, small.map)
    export_scan(model, small, tmp_path / "scan.onnx")
    weights = weights_of(ModelFile(tmp_path / "scan.onnx"))
    begun = train_scan(small, tmp_path / "run", updates=0, device=CPU, start=weights)
    for one, other in zip(model.parameters(), begun.parameters(), strict=True):
        torch.testing.assert_close(one, other, rtol=0.0, atol=0.0)
    wider = replace(small, network=replace(small.network, channels=(16, 8, 8, 8)))
    with pytest.raises(ModelError, match="do not fit"):
        train_scan(wider, tmp_path / "other", updates=3, device=CPU, start=weights)


def _shapes(settings):
    """Shapes of `Inputs` without the batch."""
    side = settings.map.side
    return (side, side), (len(MEASURED), side, side), (len(MEMORY), side, side), (len(NUMBERS),)


NETWORKS = pytest.mark.parametrize(
    "changes",
    [{}, {"deep": 0, "choice": False}, {"memory": False}, {"memory": False, "frame": True}],
    ids=["usual", "without choice", "without memory", "by image"],
)


@NETWORKS
def test_the_file_tells_what_the_network_tells(small, tmp_path, changes):
    torch.manual_seed(3)
    settings = ScanTrainSettings(map=small.map, network=replace(small.network, **changes))
    model = ScanModel(settings.network, settings.map)
    with torch.no_grad():
        for weight in model.parameters():
            weight += 0.05 * torch.randn(weight.shape)
    path = tmp_path / "scan.onnx"
    export_scan(model, settings, path)
    draws = SeededRandom(1, CPU)
    flight = draw_flight(2, small.flight, draws)
    state = new_map(2, small.map, flight.ground.height)
    _, inputs, _, _ = next_example(
        flight, state, small, draws, UpdateCalls.of(model, compiled=False)
    )
    session = onnxruntime.InferenceSession(str(path))
    fed = {i.name: np.asarray(v) for i in session.get_inputs() for v in [getattr(inputs, i.name)]}
    with torch.no_grad():
        expected = model(*inputs)
    for found, wanted in zip(session.run(None, fed), expected, strict=True):
        np.testing.assert_allclose(found, wanted, atol=3e-5)
    metadata = {k: json.loads(v) for k, v in session.get_modelmeta().custom_metadata_map.items()}
    assert MapSettings.from_toml(metadata["map"]) == settings.map
    assert [metadata[name] for name in ("measured", "memory", "numbers")] == [
        [*MEASURED],
        [*MEMORY],
        [*NUMBERS],
    ]


def test_a_larger_network_begins_as_the_one_it_starts_with(small, tmp_path):
    """What it has beside its start changes hardly anything until it has learned."""
    torch.manual_seed(9)
    model = ScanModel(replace(small.network, deep=0, choice=False), small.map).eval()
    begun = train_scan(small, tmp_path, updates=0, device=CPU, start=model.state_dict())
    draws = SeededRandom(1, CPU)
    flight = draw_flight(3, small.flight, draws)
    calls = UpdateCalls.of(model, compiled=False)
    _, inputs, _, _ = next_example(
        flight, new_map(3, small.map, flight.ground.height), small, draws, calls
    )
    with torch.no_grad():
        one, other = model(*inputs), begun(*inputs)
    assert (one[0] - other[0]).abs().median() < 0.001
    torch.testing.assert_close(one[1], other[1])


@pytest.mark.sample(1)
@NETWORKS
def test_every_network_learns(small, tmp_path, changes):
    settings = replace(small, network=replace(small.network, **changes))
    losses = []
    train_scan(
        settings, tmp_path, updates=60, device=CPU, progress=lambda found: losses.append(found.loss)
    )
    assert np.mean(losses[-4:]) < np.mean(losses[:4])


def test_a_new_network_tells_nearly_the_map(small):
    """It begins at geometry: where the map was measured, its residual is small."""
    draws = SeededRandom(2, CPU)
    flight = draw_flight(3, small.flight, draws)
    calls = UpdateCalls.of(ScanModel(small.network, small.map), compiled=False)
    _, inputs, _, _ = next_example(
        flight, new_map(3, small.map, flight.ground.height), small, draws, calls
    )
    torch.manual_seed(0)
    height, half_width = ScanModel(small.network, small.map)(*inputs)
    assert height.abs().median() < 0.02
    assert (half_width > 0.0).all()


def test_half_widths_have_a_slope_at_their_limit(small):
    """Without one a training whose half-widths have once gone there stays:
    one of two from nothing did.
    """
    model = ScanModel(small.network, small.map)
    inputs = [torch.zeros(1, *shape) for shape in _shapes(small)]
    bias = model.head.get_parameter("bias")
    width = slice(3 * small.map.sub**2, 4 * small.map.sub**2)  # residual, two gates, half-width
    with torch.no_grad():
        bias[width] = 100.0
    told = model(*inputs)
    level = torch.zeros_like(told[0])
    scan_loss(MapHeights(*told), level, level + 1.0).backward()
    assert (told[1] == WIDEST).all()
    assert (bias.grad[width] > 0.0).all()


@pytest.mark.sample(1)
@pytest.mark.parametrize("frame", [False, True], ids=["with a map", "by image"])
def test_every_method_is_scored_on_every_group(small, tmp_path, frame):
    small = replace(small, network=replace(small.network, memory=not frame, frame=frame))
    model = ScanModel(small.network, small.map).eval()
    flights = usual_flights(small.flight)
    flights = FlightSettings.from_toml(flights.to_toml().replace("images = 60", "images = 30"))
    scores = evaluate_scan(model, small, robots=3, device=CPU, rows={"usual": flights})
    every = {(s.grid, s.method, s.group): s for s in scores if s.family == "every"}
    methods = {method for _, method, _ in every}
    assert {"flat", "network", "map 2 cm", "map 2 cm, drift, feet"} <= methods
    for method in methods:
        mine = {
            group: every["scan", method, group]
            for group in ("all", "seen", "visible", "remembered", "never")
        }
        assert mine["seen"].points + mine["never"].points == mine["all"].points
        assert mine["visible"].points + mine["remembered"].points == mine["seen"].points
    assert "usual" in table_of(scores)
    write_results(scores, tmp_path / "scan.json")
    results = read_results(tmp_path / "scan.json")
    text = scan_card("1d", small, results, parameter_count(model), 1_500_000, "c0ffee")
    assert text.startswith("# Scan model 1d")
    assert "1.5 million images" in text
    assert f"| network | {every['scan', 'network', 'all'].error_mm:.1f}, " in text


def test_an_evaluation_follows_from_its_seed(small):
    rows = {"usual": replace(small.flight, rate_hz=(15.0, 20.0), images=24)}
    one, again, other = (
        evaluate_scan(None, small, robots=2, device=CPU, rows=rows, seed=seed) for seed in (5, 5, 6)
    )
    assert repr(one) == repr(again)
    assert repr(one) != repr(other)


def test_a_network_that_sees_single_images_has_no_memory():
    with pytest.raises(ConfigError, match=r"frame.*memory"):
        NetworkSettings(frame=True)


@pytest.mark.parametrize(
    "changes", [{"families": ("flat", "stair")}, {"families": ()}, {"rows": 0}, {"feet": 2.0}]
)
def test_settings_that_cannot_be_are_refused(changes):
    with pytest.raises(ConfigError, match=next(iter(changes))):
        FlightSettings(**changes)


def test_settings_read_back_equal():
    settings = ScanTrainSettings(seed=7, network=NetworkSettings(memory=False))
    assert ScanTrainSettings.from_toml(settings.to_toml()) == settings
