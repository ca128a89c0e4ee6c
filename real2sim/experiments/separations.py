"""Measures what each experiment of the menu shows of each effect, and how alike effects look there.

Each experiment is run once on a robot without effects, and every effect is added to the simulator
in an amount that matters, at all of its places at once. Not in a small one: in the limit a filter
and a delay are the same. What was so measured on the reference robot stands in `separations.json`,
which `tools/separations.py` writes.
"""

from typing import Any

import numpy as np

from saltus.arrays import Floats
from saltus.effects.profile import IDEAL
from saltus.real2sim.experiments.footage import FootageCamera
from saltus.real2sim.experiments.menu import Experiment
from saltus.real2sim.experiments.run import SensorNoise, run
from saltus.real2sim.problem.problem import Candidate, Problem, Unknown
from saltus.real2sim.sensors import SENSORS
from saltus.robots.robot import Robot

SEED = 20
STEADY = SensorNoise(base_position_m=1e-6, base_orientation_rad=1e-6)
"""The noise of the base's pose moves when a latency is added: it would look like a motion that
shows one."""
DIGITS = 4
ADDED_SCALES = 10.0
"""Added amount in scales of the unknown: 10 ms of a delay."""
NOTHING = 1e-9
"""Share of a signature's norm below which it is rounding."""


def measure(
    experiment: Experiment, robot: Robot, camera: FootageCamera | None = None
) -> dict[str, Any]:
    """The experiment's entry in the table: sizes and norms of effects by name,
    and cosines in their order.

    With a camera, only what this camera shows is measured.
    """
    log = run(experiment, robot, IDEAL, seed=SEED, noise=STEADY, camera=camera)
    signatures: dict[str, tuple[float, Floats]] = {}
    cosine: dict[tuple[str, str], float] = {}
    for sensor in SENSORS:
        if sensor.lacks(log) or (camera is not None and sensor.name != "camera"):
            continue
        here = _signatures(sensor.problem(log))
        for a, (_, mine) in here.items():
            for b, (_, theirs) in here.items():
                cosine[a, b] = _alignment(mine, theirs)
        signatures |= {name: seen for name, seen in here.items() if name not in signatures}
    names = sorted(signatures)
    visible = {
        name: [_short(signatures[name][0]), _short(float(np.linalg.norm(signatures[name][1])))]
        for name in names
    }
    # sensors see different things: two effects that no sensor sees both of cannot be taken for each
    # other
    return {
        "visible": visible,
        "cosine": [[_short(cosine.get((a, b), 0.0)) for b in names] for a in names],
    }


def _signatures(problem: Problem) -> dict[str, tuple[float, Floats]]:
    """By effect: the size that was added, and what each of its unknowns then changes,
    shape (residuals, unknowns).
    """
    spans, start = [], 0
    for candidate in problem.candidates:
        spans.append(slice(start, start + len(candidate.unknowns)))
        start += len(candidate.unknowns)
    null = problem.absent
    rows = [null]
    columns: dict[str, list[int]] = {}
    nuisances: list[int] = []
    for name in dict.fromkeys(candidate.effect for candidate in problem.candidates):
        own = [i for i, candidate in enumerate(problem.candidates) if candidate.effect == name]
        for k, unknown in enumerate(problem.candidates[own[0]].unknowns):
            if unknown.is_shape:
                continue
            row = null.copy()
            for i in own:
                row[spans[i].start + k] += _amount(problem.candidates[i].unknowns[k])
            (
                nuisances
                if problem.candidates[own[0]].is_nuisance
                else columns.setdefault(name, [])
            ).append(len(rows))
            rows.append(row)
    unknowns = np.repeat(np.array(rows)[:, None], len(problem.blocks), axis=1)
    residuals = np.concatenate(
        [problem.residuals(unknowns[i : i + 1]) for i in range(len(unknowns))]
    )
    change = (residuals[1:] - residuals[0]).reshape(len(rows) - 1, -1)
    basis = _basis(change[[i - 1 for i in nuisances]].T)
    by_name = {candidate.effect: candidate for candidate in problem.candidates}
    found = {}
    for name, indices in columns.items():
        signature = change[[i - 1 for i in indices]].T
        found[name] = (_size(by_name[name]), signature - basis @ (basis.T @ signature))
    return found


def _amount(unknown: Unknown) -> float:
    return min(ADDED_SCALES * unknown.scale, 0.5 * unknown.high)


def _size(candidate: Candidate) -> float:
    """Returns what the added amount is in the first parameter;
    0 where the parameter of no effect is infinite.
    """
    null = candidate.absent
    added = null + np.array([0.0 if u.is_shape else _amount(u) for u in candidate.unknowns])
    before, after = (next(iter(candidate.parameters(x).values())).value for x in (null, added))
    return abs(after - before) if np.isfinite(after - before) else 0.0


def _basis(columns: Floats) -> Floats:
    """Orthonormal columns with the span of the given ones."""
    if not columns.shape[1]:
        return columns
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(u[:, s > NOTHING * max(s[0], NOTHING)])


def _alignment(mine: Floats, theirs: Floats) -> float:
    """Cosine of the smallest angle between two spans."""
    if not mine.any() or not theirs.any():
        return 1.0
    return float(min(1.0, np.linalg.svd(_basis(mine).T @ _basis(theirs), compute_uv=False)[0]))


def _short(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
