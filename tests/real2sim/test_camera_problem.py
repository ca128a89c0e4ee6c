"""The problem of the depth camera, on logs that are rendered by other means."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import open3d
import pytest
from camera_logs import (
    FLAT,
    LATENCY_S,
    POST,
    STEP,
    WALL,
    Recipe,
    Truth,
    camera_log,
    chirp,
    corners,
    rocking,
    sine,
    still,
)
from stated_values import check_stated_values

from saltus.arrays import Floats
from saltus.effects.image_delivery import CameraLatency
from saltus.effects.profile import Profile
from saltus.errors import RecordingError
from saltus.real2sim.problem.camera.edges import edge_counts
from saltus.real2sim.problem.camera.log_images import frames_of
from saltus.real2sim.problem.camera.problem import CameraProblem
from saltus.real2sim.problem.camera.rays import claimed_scenes
from saltus.real2sim.search.search import search_effects
from saltus.real2sim.sensors import SENSORS
from saltus.real2sim.stacked_problem import RebasedProblem
from saltus.recordings.run_log import DepthTable
from saltus.terrain.boxes import Boxes

STEP_SHARE = 0.1  # of an unknown's scale, for differences


def problem(**recipe: Any) -> CameraProblem:
    return CameraProblem(camera_log(Recipe(**recipe)))


@cache
def claimed() -> CameraProblem:
    return problem(boxes=STEP, motion=rocking, duration_s=8.0)


def columns(
    of: CameraProblem, effects: tuple[str, ...]
) -> tuple[list[int], Floats, Floats, Floats]:
    """Places of unknowns of effects and nuisances; starts, scales and bounds of all."""
    unknowns = [(c, u) for c in of.candidates for u in c.unknowns]
    start = np.concatenate([c.starts[0] for c in of.candidates])
    free = [i for i, (c, _) in enumerate(unknowns) if c.effect in effects or c.is_nuisance]
    return (
        free,
        start,
        np.array([u.scale for _, u in unknowns]),
        np.array([(u.low, u.high) for _, u in unknowns]),
    )


def derivatives(of: CameraProblem, at: Floats, free: list[int], scale: Floats) -> Floats:
    """Shape (free, m)."""
    moved = np.repeat(at[None], len(free), axis=0)
    step = STEP_SHARE * scale[free]
    moved[np.arange(len(free)), free] += step
    values = of.residuals(np.concatenate([at[None], moved])[:, None])[:, 0]
    return (values[1:] - values[0]) / step[:, None]


def fitted(of: CameraProblem, *effects: str) -> tuple[dict[str, float], Floats]:
    """Damped Gauss-Newton over the named effects and the nuisances:
    their parameters, and what is left.
    """
    free, at, scale, bounds = columns(of, effects)
    left = of.residuals(at[None, None])[0, 0]
    damping = 1e-6
    for _ in range(20):
        slope = derivatives(of, at, free, scale)
        normal = slope @ slope.T
        trial = at.copy()
        trial[free] -= np.linalg.solve(
            normal + damping * np.diag(np.diag(normal) + 1e-12), slope @ left
        )
        trial = np.clip(trial, *bounds.T)
        rest = of.residuals(trial[None, None])[0, 0]
        better = left @ left - rest @ rest
        if better > 0.0:
            at, left, damping = trial, rest, max(0.2 * damping, 1e-9)
        else:
            damping = max(10.0 * damping, 1e-3)
        if 0.0 <= better < 0.01:
            break
    found, first = {}, 0
    for candidate in of.candidates:
        values = at[first : first + len(candidate.unknowns)]
        first += len(candidate.unknowns)
        if candidate.effect in effects:
            found[candidate.effect] = next(iter(candidate.parameters(values).values())).value
    return found, left


CASES: dict[str, tuple[dict[str, Any], dict[str, tuple[float, float]]]] = {
    "nothing": ({}, {}),
    "latency": ({"truth": Truth(latency=0.055)}, {"camera_latency": (0.055, 5e-4)}),
    "latency, stamped": (
        {"truth": Truth(latency=0.1), "motion": rocking, "has_capture": True},
        {"camera_latency": (0.1, 5e-4)},
    ),
    "smear": (
        {"truth": Truth(alpha=0.5), "motion": rocking, "boxes": STEP},
        {"temporal_smear": (0.5, 0.01)},
    ),
    "both": (
        {"truth": Truth(latency=0.07, alpha=0.6), "boxes": STEP},
        {"camera_latency": (0.07, 2e-3), "temporal_smear": (0.6, 0.02)},
    ),
    "pitch": (
        {"truth": Truth(pitch=0.03), "motion": still, "boxes": WALL},
        {"camera_pitch": (0.03, 5e-4)},
    ),
    "height": ({"truth": Truth(height=-0.01), "boxes": STEP}, {"camera_height": (-0.01, 5e-4)}),
    "fov": ({"truth": Truth(fov=1.02), "boxes": WALL}, {"camera_fov": (1.02, 1e-3)}),
    "scale": (
        {"truth": Truth(scale=0.98), "motion": still, "boxes": WALL},
        {"depth_scale": (0.98, 1e-3)},
    ),
    "bias": (
        {"truth": Truth(bias=0.01), "motion": still, "boxes": WALL},
        {"depth_bias": (0.01, 5e-4)},
    ),
    "clip": ({"truth": Truth(clip=1.5)}, {"range_clip": (1.5, 0.01)}),
    "noise": ({"truth": Truth(subpixel=0.01)}, {"depth_noise": (0.01, 6e-4)}),
    "holes": ({"truth": Truth(holes=5), "boxes": POST}, {"edge_holes": (5.0, 0.3)}),
    "filled": (
        {"truth": Truth(holes=6, fill=3), "boxes": POST},
        {"edge_holes": (6.0, 0.6), "hole_fill": (3.0, 0.4)},
    ),
    "drops": ({"truth": Truth(drop=0.1), "duration_s": 20.0}, {"frame_drop": (0.1, 0.04)}),
    "jitter": ({"truth": Truth(latency=0.06, jitter=0.006)}, {"camera_latency": (0.06, 1e-3)}),
}


ROUGH = ("nothing", "both", "pitch", "clip", "filled")


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    ("case", "is_rough"), [*((case, False) for case in CASES), *((case, True) for case in ROUGH)]
)
def test_what_is_hidden_is_found_and_leaves_noise(case: str, is_rough: bool) -> None:
    recipe, truth = CASES[case]
    hidden = problem(**{"duration_s": 10.0, "rate_hz": 20.0, **recipe}, is_rough=is_rough)
    found, left = fitted(hidden, *truth)
    for name, (value, tolerance) in truth.items():
        assert found[name] == pytest.approx(value, abs=tolerance), name
    depth = hidden.signal == hidden.signals.index("depth")
    # clipped pixels have no noise; noise that neighbours share shows less between them than it is
    assert np.mean(left[depth] ** 2) == pytest.approx(
        1.0, abs=0.2 if is_rough or case == "clip" else 0.1
    )
    assert abs(np.mean(left[depth])) < 0.02
    assert np.mean(left[~depth] ** 2) < 2.0


def likeness(of: CameraProblem, one: str, other: str) -> float:
    """|cos| of the residuals of two effects, with nuisances projected out."""
    free, at, scale, _ = columns(of, (one, other))
    owner = [c.effect for c in of.candidates for _ in c.unknowns]
    slope = {owner[i]: d for i, d in zip(free, derivatives(of, at, free, scale), strict=True)}
    a, b = slope[one], slope[other]
    return float(abs(a @ b) / np.sqrt((a @ a) * (b @ b)))


def test_a_single_sine_cannot_tell_latency_from_smear_and_a_chirp_can() -> None:
    assert (
        likeness(problem(motion=sine, duration_s=10.0), "camera_latency", "temporal_smear") > 0.95
    )
    assert (
        likeness(
            problem(motion=chirp, boxes=STEP, duration_s=10.0), "camera_latency", "temporal_smear"
        )
        < 0.95
    )


def test_a_flat_floor_cannot_tell_scale_from_height_and_a_wall_can() -> None:
    assert likeness(problem(motion=still, duration_s=12.0), "depth_scale", "camera_height") > 0.95
    assert (
        likeness(problem(motion=still, boxes=WALL, duration_s=12.0), "depth_scale", "camera_height")
        < 0.95
    )


def test_what_a_log_cannot_show_is_said_with_numbers() -> None:
    why = problem(motion=still, duration_s=8.0).untestable
    assert set(why) == {"camera_latency", "temporal_smear", "edge_holes", "hole_fill", "range_clip"}
    assert "10 ms change depth by 0." in why["camera_latency"]
    assert "m would not show" in why["range_clip"]
    assert "edge_holes" not in problem(boxes=POST, duration_s=8.0).untestable
    few = problem(duration_s=1.5).untestable
    assert "fewer than 50" in few["frame_drop"]


@pytest.mark.parametrize("seed", [0, 2])
@pytest.mark.parametrize("share", [0.01, 0.02, 0.03, 0.1])
def test_a_few_lost_images_are_named_or_nothing_is(share: float, seed: int) -> None:
    found = search_effects(problem(truth=Truth(drop=share), duration_s=12.0, seed=seed), seed=seed)
    assert found.verdict == ("named" if found.effects else "no_gap")
    assert {effect.name for effect in found.effects} <= {"frame_drop"}
    assert found.effects or share < 0.1


def test_residuals_are_finite_at_every_bound_and_sets_do_not_mix() -> None:
    _, start, _, bounds = columns(claimed(), ())
    sets = np.concatenate(
        [start[None], bounds.T, np.where(np.eye(len(start)) > 0, bounds[:, 1], start)]
    )[:, None]
    together = claimed().residuals(sets)
    assert together.shape == (len(sets), 1, len(claimed().signal))
    assert np.all(np.isfinite(together))
    assert np.max(np.abs(together)) < 200.0
    for values, expected in zip(sets, together, strict=True):
        np.testing.assert_array_equal(claimed().residuals(values[None])[0], expected)


def test_what_a_profile_has_is_taken_from_its_values_exactly() -> None:
    check_stated_values(claimed())


def test_every_residual_has_a_place() -> None:
    count = len(claimed().signal)
    assert claimed().segment.shape == claimed().time_s.shape == (count,)
    for k, segment in enumerate(claimed().segments):
        times = claimed().time_s[claimed().segment == k]
        assert times.size
        assert np.all((times >= segment.start_s) & (times <= segment.end_s))


@pytest.mark.parametrize("has_ground_box", [False, True])
def test_the_ground_may_be_a_box_or_go_without_saying(has_ground_box: bool) -> None:
    log = camera_log(Recipe(boxes=STEP, duration_s=8.0))
    if has_ground_box:
        log.meta["terrain"] = [
            *log.meta["terrain"],
            {"center": [0.0, 0.0, -0.5], "size": [20.0, 20.0, 1.0]},
        ]
    residual = CameraProblem(log).residuals(
        np.zeros((1, 1, len(columns(CameraProblem(log), ())[1])))
    )
    assert np.mean(residual**2) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("missing", ["depth", "segments"])
def test_a_log_that_cannot_be_used_is_refused(missing: str) -> None:
    log = camera_log(Recipe(duration_s=2.0))
    if missing == "depth":
        log = replace(log, depth=None)
    else:
        log.meta["segments"] = [{"name": "late", "t0": 2.9, "t1": 2.95, "condition": "late"}]
    with pytest.raises(RecordingError):
        CameraProblem(log)


@pytest.mark.parametrize("claim", [None, {}])
def test_images_of_no_claimed_camera_pose_no_problem(claim: dict[str, float] | None) -> None:
    log = camera_log(Recipe(duration_s=2.0))
    log.meta["camera"] = claim
    sensor = next(sensor for sensor in SENSORS if sensor.name == "camera")
    assert sensor.lacks(log) == "meta.json claims no camera"


def test_rays_are_those_of_a_ray_caster() -> None:
    rng = np.random.default_rng(1)
    boxes = [
        {"center": rng.uniform(-2, 2, 3).tolist(), "size": rng.uniform(0.1, 1.0, 3).tolist()}
        for _ in range(6)
    ]
    scene = claimed_scenes(Boxes.from_tables(boxes))[1]
    reference = open3d.t.geometry.RaycastingScene(nthreads=1)
    for low, high in map(corners, boxes):
        mesh = open3d.t.geometry.TriangleMesh.create_box(*(high - low).tolist())
        reference.add_triangles(mesh.translate(open3d.core.Tensor(low.astype(np.float32))))
    origin = rng.uniform(3.0, 4.0, (5, 3))
    direction = rng.uniform(-1.0, -0.6, (5, 3, 400))
    rays = np.concatenate(
        [np.broadcast_to(origin[:, None], (5, 400, 3)), direction.transpose(0, 2, 1)], axis=-1
    )
    expected = reference.cast_rays(open3d.core.Tensor(rays.astype(np.float32)))["t_hit"].numpy()
    ours = scene.depth(origin, direction)
    assert np.isfinite(ours).sum() > 100
    # Rays along an edge may go either way
    assert np.mean(np.isfinite(ours) == np.isfinite(expected)) > 0.999
    both = np.isfinite(ours) & np.isfinite(expected)
    np.testing.assert_allclose(ours[both], expected[both], rtol=1e-4)


def table(count: int, kept: Floats, repeats: bool = False, numbered: bool = True) -> DepthTable:
    """A camera at 50 Hz that loses the images that are not kept,
    or sends the one before instead.
    """
    rng = np.random.default_rng(0)
    images = rng.integers(500, 900, (count, 4, 5)).astype(np.uint16)
    if repeats:
        source = np.maximum.accumulate(np.where(kept, np.arange(count), 0))
        return DepthTable(
            arrival_s=0.02 * np.arange(count),
            capture_s=None,
            frame_id=np.arange(count),
            depth_mm=images[source],
        )
    index = np.flatnonzero(kept)
    return DepthTable(
        arrival_s=0.02 * index,
        capture_s=None,
        frame_id=index if numbered else np.arange(len(index)),
        depth_mm=images[index],
    )


@pytest.mark.parametrize("how", ["gaps in the numbers", "gaps in time", "repeats"])
def test_lost_images_are_counted_however_they_are_lost(how: str) -> None:
    kept = np.random.default_rng(5).random(400) > 0.2
    kept[[0, -1]] = True
    frames = frames_of(table(400, kept, repeats=how == "repeats", numbered=how != "gaps in time"))
    np.testing.assert_array_equal(frames.lost, ~kept)
    np.testing.assert_allclose(frames.due_s, 0.02 * np.arange(400), atol=1e-9)
    assert len(frames.index) == kept.sum()
    assert not np.any(frames.jitter_s)


@pytest.mark.parametrize(("holes", "copies"), [(0, 0), (3, 0), (0, 4), (2, 5)])
def test_holes_and_copies_at_edges_are_counted(holes: int, copies: int) -> None:
    rng = np.random.default_rng(3)
    true = np.full((4, 10, 60), 2.0)
    true[..., 40:50] = 1.0
    image = np.rint(1e3 * true + rng.normal(0.0, 4.0, true.shape)).astype(np.uint16)
    image[..., 40 - holes : 40] = 0
    first = 40 - holes - copies
    image[..., first : first + copies] = image[..., first - 1 : first]
    counts = edge_counts(true, image, 3.0)
    assert counts.frame.size == 40
    assert np.mean(counts.holes) == pytest.approx(holes, abs=0.01)
    assert np.mean(counts.copies) == pytest.approx(copies, abs=0.6)  # noise makes equal pixels, too


@pytest.mark.parametrize("slope_mm", [1.0, 5.0, 30.0])
def test_a_few_pairs_of_neighbours_are_no_rate_of_copies(slope_mm: float) -> None:
    """One pair of all slopes beyond the edge shows by chance what thousands at the edge do not."""
    rng = np.random.default_rng(4)
    true = np.full((40, 10, 60), 2.0)
    true[..., 40:50] = 1.0 + 1e-3 * slope_mm * np.maximum(41 - np.arange(40, 50), 0)
    lone = true.copy()
    lone[0, 0, 44:50] += 1e-3 * slope_mm
    image = np.rint(1e3 * lone + rng.normal(0.0, 1.0, true.shape)).astype(np.uint16)
    image[0, 0, 44] = image[0, 0, 43]
    counts = edge_counts(lone, image, 3.0)
    assert np.mean(counts.copies) == pytest.approx(0.0, abs=0.3)


def test_no_edge_counts_on_flat_ground() -> None:
    assert not edge_counts(
        np.full((2, 8, 40), 1.5), np.full((2, 8, 40), 1500, dtype=np.uint16), 3.0
    ).frame.size
    assert claimed_scenes(Boxes.from_tables([]))[0].has_ground
    assert FLAT == ()


@pytest.mark.parametrize("latency_s", [LATENCY_S, 0.08])
def test_a_profile_that_agrees_with_a_claim_has_nothing_to_be_taken_out(latency_s: float) -> None:
    problem = CameraProblem(camera_log(Recipe(duration_s=2.0)))
    leaner = RebasedProblem(problem, Profile(camera=(CameraLatency(latency=latency_s),))).leaner()
    assert set(leaner) == (set() if latency_s == LATENCY_S else {"camera_latency"})
