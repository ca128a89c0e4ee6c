import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from heightmap_inputs import MS, WARMUP, frame, on_time, service_of, states
from samples import ROBOT
from service_runs import DEGRADED, INVALID, OK, WARMING, Faulty, bad_tick, clean, run, without

from saltus.effects.image_delivery import CameraLatency
from saltus.effects.profile import Profile
from saltus.heightmap.service.image_watch import less_trusted
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.service import HeightmapService
from saltus.wire.messages import DepthFrame, Heightmap, HeightmapStatus


def same(left: list[Heightmap], right: list[Heightmap]) -> bool:
    return all(
        np.array_equal(a.height, b.height)
        and np.array_equal(a.half_width_90, b.half_width_90)
        and a.status == b.status
        for a, b in zip(left, right, strict=True)
    )


def test_warms_up_and_stays_ok(model_path: Path) -> None:
    statuses = [h.status for h in run(service_of(model_path), clean(60), 60)]
    first_ok = 5 + 2 * (WARMUP - 1)
    assert statuses[:first_ok] == [WARMING] * first_ok
    assert statuses[first_ok:] == [OK] * (60 - first_ok)


def test_answers_name_state_image_and_model(model_path: Path) -> None:
    service = service_of(model_path)
    answers = run(service, clean(40), 40)
    assert [h.step for h in answers] == list(range(40))
    assert [h.time_ns for h in answers] == [10 * MS * step for step in range(40)]
    assert {h.model_id for h in answers} == {service.model_id}
    assert answers[0].frame_id == -1
    assert answers[0].depth_age_s == math.inf
    assert [answers[i].depth_age_s for i in (21, 22)] == pytest.approx([0.05, 0.06])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -5.0, 1e30])
@pytest.mark.parametrize("pixels", [1, 230, 768])
def test_bad_pixels_do_not_poison(model_path: Path, value: float, pixels: int) -> None:
    frames = clean(80)
    good = frames[31]
    assert good is not None
    depth = good.depth.astype(np.float32)
    depth.flat[np.random.default_rng(0).permutation(768)[:pixels]] = value
    frames[31] = frame(good.frame_id, good.time_ns / MS, depth)
    with np.errstate(all="ignore"):
        answers = run(service_of(model_path), frames, 80)
    assert all(np.isfinite(h.height).all() and np.isfinite(h.half_width_90).all() for h in answers)
    assert answers[33].status == OK  # one image later


@pytest.mark.parametrize(
    ("share", "status"),
    [(0.0, OK), (0.25, OK), (0.35, DEGRADED), (0.75, DEGRADED), (0.85, DEGRADED)],
)
def test_invalid_pixels_are_counted(
    model_path: Path, share: float, status: HeightmapStatus
) -> None:
    frames = clean(41)
    depth = np.full(768, 900, np.uint16)
    depth[: int(share * 768)] = 0
    frames[39] = frame(17, 340.0, depth.reshape(48, 16))
    assert run(service_of(model_path), frames, 41)[39].status == status


def test_duplicates_and_overtaken_frames_have_no_effect(model_path: Path) -> None:
    frames = clean(80)
    disturbed = dict(frames)
    for step in range(20, 80, 2):  # steps without a frame of their own
        disturbed[step] = frames[step - 1] if step % 4 else frames[step - 7]
    reference = run(service_of(model_path), frames, 80)
    assert same(run(service_of(model_path), disturbed, 80), reference)


def test_frames_too_old_or_from_the_future_are_not_used(model_path: Path) -> None:
    frames = {step: None if step >= 40 else on_time(step) for step in range(80)}
    disturbed = dict(frames)
    disturbed[41] = frame(100, 410.0 - 171.0)
    disturbed[43] = frame(101, 430.0 + 6.0)
    reference = run(service_of(model_path), frames, 80)
    assert same(run(service_of(model_path), disturbed, 80), reference)


def test_a_state_is_answered_once(model_path: Path) -> None:
    service = service_of(model_path)
    answers = run(service, clean(40), 40)
    again = service.step(states(40)[-1], frame(99, 345.0), 395 * MS)
    older = service.step(states(40)[7], None, 395 * MS)
    assert again is answers[-1]
    assert older is answers[-1]
    following = service.step(states(41)[40], on_time(40), 400 * MS)
    assert same([following], run(service_of(model_path), clean(41), 41)[-1:])


def test_loss_is_told_within_60_and_110_ms_of_the_last_arrival(model_path: Path) -> None:
    last = 61
    frames = {step: frame_ for step, frame_ in clean(100).items() if step <= last}
    statuses = [h.status for h in run(service_of(model_path), frames, 100)]
    assert set(statuses[20 : last + 6]) == {OK}
    assert statuses[last + 6] == DEGRADED
    assert statuses[last + 8] == DEGRADED
    assert set(statuses[last + 9 :]) == {INVALID}


@pytest.mark.sample(12)
@pytest.mark.parametrize("camera_ms", [0, 50, 165])
@pytest.mark.parametrize("extra_ms", range(0, 200, 10))
def test_late_frames_switch_the_status_at_the_thresholds(
    model_path: Path, extra_ms: int, camera_ms: int
) -> None:
    usual_ms = max(50, camera_ms)
    depth = Profile(camera=(CameraLatency(latency=1e-3 * camera_ms),)).depth_topic
    frames = {step: on_time(step - (usual_ms - 50 + extra_ms) // 10) for step in range(110)}
    service = HeightmapService(HeightmapNetwork(ROBOT, model_path), depth)
    answers = run(service, frames, 110)[70:]
    for answer in answers:
        if extra_ms > 120:  # 120 ms older than usual on arrival
            assert answer.status == INVALID
            assert answer.frame_id == -1
        else:
            late = answer.depth_age_s > 1e-3 * usual_ms + 0.07 + 1e-6
            lost = answer.depth_age_s > 1e-3 * usual_ms + 0.12 + 1e-6
            assert answer.status == (INVALID if lost else DEGRADED if late else OK)


def test_resumes_after_a_gap_with_an_empty_hidden_state(model_path: Path) -> None:
    frames = {step: frame_ for step, frame_ in clean(120).items() if not 40 <= step < 70}
    statuses = [h.status for h in run(service_of(model_path), frames, 120)]
    back = 71
    assert statuses[back - 1] == INVALID
    assert statuses[back] == WARMING
    assert statuses[back + 2 * (WARMUP - 1)] == OK


def test_short_gaps_do_not_cost_the_hidden_state(model_path: Path) -> None:
    frames = {step: frame_ for step, frame_ in clean(80).items() if not 41 <= step < 50}
    statuses = [h.status for h in run(service_of(model_path), frames, 80)]
    assert WARMING not in statuses[41:]


def test_without_any_frame_it_becomes_invalid(model_path: Path) -> None:
    statuses = [h.status for h in run(service_of(model_path), {}, 30)]
    assert statuses[17] == WARMING
    assert statuses[18:] == [INVALID] * 12


def test_a_robot_state_that_is_not_finite_does_no_lasting_harm(model_path: Path) -> None:
    service = service_of(model_path)
    service.step(states(1)[0], None, 0)
    for state in states(60)[1:]:
        if state.step == 30:
            state.joint_position[4] = np.nan
        answer = service.step(state, on_time(state.step), state.time_ns)
        assert np.isfinite(answer.height).all()
        if state.step == 30:
            assert answer.status == DEGRADED
            state.joint_position[4] = -1.8
    assert answer.status == OK


@pytest.mark.sample(3)
@pytest.mark.parametrize("seed", range(8))
def test_no_fault_hides_that_a_hidden_state_is_too_young(model_path: Path, seed: int) -> None:
    """Whatever else is wrong: a planner goes on with DEGRADED heights."""
    rng, service = np.random.default_rng(seed), service_of(model_path)
    poor = rng.choice(400, 150)
    service._network = Faulty(
        service, {step: bad_tick("height", np.nan) for step in poor[:10].tolist()}
    )  # type: ignore[assignment]
    young = set()
    for state in states(400):
        image = on_time(state.step - (4 if state.step in poor else 0))
        if image is not None and state.step in poor:
            image.depth[:, : image.depth.shape[1] // 2] = 0
        if state.step % 100 < 15:
            image = None
        status = service.step(state, image, state.time_ns).status
        young |= set() if service.warm else {status}
    assert WARMING in young
    assert young <= {WARMING, INVALID}


@pytest.mark.parametrize("seed", range(4))
def test_disorder_is_as_if_the_overtaken_frames_were_missing(model_path: Path, seed: int) -> None:
    """Frames come in any order, some twice: the heightmaps are those of the frames that were news,
    to the bit.
    """
    rng = np.random.default_rng(seed)
    arriving: dict[int, DepthFrame | None] = {}
    news: dict[int, DepthFrame | None] = {}
    newest = -1
    for step in range(200):
        late = int(rng.integers(0, 8)) if rng.uniform() < 0.5 else 0
        frame_ = on_time(step - late)
        arriving[step] = frame_
        if frame_ is not None and frame_.frame_id > newest:
            newest, news[step] = frame_.frame_id, frame_
    assert same(
        run(service_of(model_path), arriving, 200),
        run(service_of(model_path), news, 200),
    )


@pytest.mark.parametrize("count", range(1, 12, 2))
def test_an_image_of_nothing_is_not_shown_to_the_network(model_path: Path, count: int) -> None:
    """The heightmaps are those of a run without it, and DEGRADED until the camera sees again.

    They are INVALID when they would be without it.
    """
    blind = {20 + i for i in range(count)}
    spoilt = {
        step: replace(good, depth=np.zeros_like(good.depth))
        if good is not None and good.frame_id in blind
        else good
        for step, good in clean(120).items()
    }
    answers = run(service_of(model_path), spoilt, 120)
    expected = run(service_of(model_path), without(lambda number: number in blind, 120), 120)
    np.testing.assert_array_equal([h.height for h in answers], [h.height for h in expected])
    assert [h.frame_id for h in answers] == [h.frame_id for h in expected]
    first, back = 2 * 20 + 5, 2 * (20 + count) + 5
    lost = [less_trusted(h.status, DEGRADED) for h in expected[first:back]]
    assert [h.status for h in answers[first:back]] == lost
    assert (INVALID in lost) == (count > 3)  # none for 80 ms
    after = [h.status for h in answers[back:]]
    assert after == (
        [OK] * len(after)
        if count <= 5
        else [WARMING] * (2 * (WARMUP - 1)) + [OK] * (len(after) - 6)
    )


def test_a_camera_that_never_sees_anything_is_invalid(model_path: Path) -> None:
    frames = {
        step: None if good is None else replace(good, depth=np.zeros_like(good.depth))
        for step, good in clean(40).items()
    }
    answers = run(service_of(model_path), frames, 40)
    without_any = run(service_of(model_path), {}, 40)
    assert [h.status for h in answers] == [h.status for h in without_any]
    assert answers[-1].status == INVALID
    assert {h.frame_id for h in answers} == {-1}


@pytest.mark.parametrize("size", [(1, 1), (2, 3000), (48, 15), (240, 424), (720, 1280)])
@pytest.mark.parametrize("focal", [1.0, 42.0, 1e4])
def test_images_of_any_size_and_lens_are_survived(
    model_path: Path, size: tuple[int, int], focal: float
) -> None:
    service = service_of(model_path)
    rng = np.random.default_rng(0)
    for state in states(60):
        given = on_time(state.step)
        if given is not None and state.step >= 40:
            depth = rng.integers(0, 65536, size).astype(np.uint16)
            given = replace(given, depth=depth, fx=focal, fy=focal, cx=size[1] / 2, cy=size[0] / 2)
        answer = service.step(state, given, state.time_ns)
        assert np.isfinite(answer.height).all()
        assert np.isfinite(answer.half_width_90).all()
