"""Faults of the network and of many lost images, as the heightmap service tells them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from heightmap_inputs import WARMUP, on_time, service_of
from samples import ROBOT
from service_runs import DEGRADED, INVALID, OK, WARMING, Faulty, bad_tick, clean, run, without

from saltus.errors import ModelError
from saltus.heightmap.service import model_check
from saltus.heightmap.service.sight import NetworkOutputs
from saltus.wire.messages import HeightmapStatus


@pytest.mark.parametrize(
    "bad",
    [bad_tick(w, v) for w in ("height", "half_width_90", "hidden") for v in (np.nan, np.inf, -2.1)]
    + [bad_tick("height", 2.1)],
)
def test_a_bad_output_is_bridged_and_its_hidden_state_dropped(
    model_path: Path, bad: NetworkOutputs
) -> None:
    service = service_of(model_path)
    service._network = faulty = Faulty(service, {50: bad})  # type: ignore[assignment]
    answers = run(service, clean(60), 60)
    assert answers[50].status == DEGRADED
    assert np.array_equal(answers[50].height, answers[49].height)
    np.testing.assert_array_equal(faulty.hidden_seen[51], faulty.hidden_seen[50])
    assert {h.status for h in answers[51:]} == {OK}


def test_three_bad_outputs_are_invalid_and_reset(model_path: Path) -> None:
    service = service_of(model_path)
    service._network = faulty = Faulty(
        service, {50 + i: bad_tick("height", np.nan) for i in range(5)}
    )  # type: ignore[assignment]
    statuses = [h.status for h in run(service, clean(80), 80)]
    assert statuses[50:55] == [DEGRADED, DEGRADED, INVALID, INVALID, INVALID]
    assert not faulty.hidden_seen[53].any()
    assert statuses[55] == WARMING
    assert statuses[-1] == OK


@pytest.mark.parametrize("moves", [True, False])
def test_an_output_that_never_changes_is_told_after_a_second_if_the_input_changes(
    model_path: Path, moves: bool
) -> None:
    service = service_of(model_path)
    frozen = NetworkOutputs.of(np.full((1, 30), -0.27), np.full((1, 30), 0.02), np.zeros((1, 256)))
    service._network = Faulty(service, dict.fromkeys(range(50, 200), frozen))  # type: ignore[assignment]
    still = on_time(49)
    assert still is not None
    frames = {
        step: good if moves or step < 50 or good is None else replace(good, depth=still.depth)
        for step, good in clean(260).items()
    }
    answers = run(service, frames, 260)
    told = {answer.step for answer in answers if answer.status == DEGRADED}
    # the first of the same answers was the 50th; a still scene may well give the same answer
    assert told == (set(range(151, 200)) if moves else set())
    assert answers[-1].status == OK


def test_the_same_output_in_fewer_ticks_than_a_second_is_no_fault(model_path: Path) -> None:
    service = service_of(model_path)
    frozen = NetworkOutputs.of(np.full((1, 30), -0.27), np.full((1, 30), 0.02), np.zeros((1, 256)))
    service._network = Faulty(service, dict.fromkeys(range(50, 151), frozen))  # type: ignore[assignment]
    assert {answer.status for answer in run(service, clean(200), 200)[20:]} == {OK}


@pytest.mark.parametrize(
    ("period", "status"), [(20, OK), (5, OK), (4, DEGRADED), (3, DEGRADED), (2, DEGRADED)]
)
def test_more_than_a_fifth_of_lost_frames_is_told(
    model_path: Path, period: int, status: HeightmapStatus
) -> None:
    frames = without(lambda number: number > 60 and number % period == 0, 400)
    statuses = [h.status for h in run(service_of(model_path), frames, 400)]
    assert set(statuses[20:120]) == {OK}
    assert set(statuses[250:]) == {status}


@pytest.mark.sample(2)
@pytest.mark.parametrize("seed", range(5))
def test_five_percent_of_random_losses_change_no_status(model_path: Path, seed: int) -> None:
    lost = np.random.default_rng(seed).uniform(size=1000) < 0.05
    frames = without(lambda number: number > 20 and bool(lost[number]), 1000)
    assert {h.status for h in run(service_of(model_path), frames, 1000)[60:]} == {OK}


def test_status_is_back_a_second_after_many_losses(model_path: Path) -> None:
    frames = without(lambda number: 60 < number <= 100 and number % 2 == 0, 400)
    statuses = [h.status for h in run(service_of(model_path), frames, 400)]
    last_seen = 2 * 101 + 5
    assert statuses[last_seen] == DEGRADED
    assert set(statuses[last_seen + 100 :]) == {OK}


@pytest.mark.parametrize("burst", range(1, 50, 6))
def test_a_burst_of_losses_costs_half_a_second_at_most(model_path: Path, burst: int) -> None:
    frames = without(lambda number: 60 < number <= 60 + burst, 300)
    statuses = [h.status for h in run(service_of(model_path), frames, 300)]
    back = 2 * (61 + burst) + 5
    assert set(statuses[back + 2 * (WARMUP - 1) :]) == {OK}
    assert (statuses[back] == WARMING) == (burst > 5)


@pytest.mark.parametrize("tick", [1, 3, WARMUP + 2])
def test_a_model_with_one_bad_output_fails_its_check(
    model_path: Path, tick: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    faulty = Faulty(service_of(model_path), {tick: bad_tick("height", np.nan)})
    monkeypatch.setattr(model_check, "HeightmapNetwork", lambda *_: faulty)
    with pytest.raises(
        ModelError, match=f"after {tick} good images the heightmap is (not plausible|DEGRADED)"
    ):
        model_check.checked_model(ROBOT, model_path)
