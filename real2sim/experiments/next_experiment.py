"""Which experiment would tell the effects of a set apart.

What one unit of every effect does to the whitened residuals of each experiment, and how alike two
effects look there, was measured once on a robot without effects: each experiment is run once, and
every effect is added to the simulator in an amount that matters, at all of its places at once. Not
in a small one: in the limit a filter and a delay are the same. What was so measured on the
reference robot stands in `separations.json`, which `tools/separations.py` writes. How far two
fitted rivals are expected to be apart follows without any simulation. For effects of a camera the
experiments are measured anew with the claimed camera: one that looks down hardly sees a wall.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np

from saltus.arrays import Floats
from saltus.effects.profile import IDEAL
from saltus.real2sim.experiments.footage import FootageCamera
from saltus.real2sim.experiments.menu import EXPERIMENTS, SEPARATIONS, Experiment
from saltus.real2sim.experiments.run import SensorNoise, run_experiment
from saltus.real2sim.problem.problem import Candidate, Problem, Unknown
from saltus.real2sim.search.findings import FoundEffect
from saltus.real2sim.sensors import SENSORS
from saltus.real2sim.verdict import NextExperiment, largest_distance
from saltus.recordings.run_claims import RigClaims
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


def measure_separations(
    experiment: Experiment, robot: Robot, camera: FootageCamera | None = None
) -> dict[str, Any]:
    """The experiment's entry in the table: sizes and norms of effects by name,
    and cosines in their order.

    With a camera, only what this camera shows is measured.
    """
    log = run_experiment(experiment, robot, IDEAL, seed=SEED, noise=STEADY, camera=camera)
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


@dataclass(frozen=True, kw_only=True)
class EffectSeparations:
    """How well one experiment tells pairs of effects apart."""

    visible: dict[str, tuple[float, float]]
    """Size of an effect in its first parameter, as deviation from null, or 0 where that is
    infinite; and the norm of what this size changes in the whitened residuals, nuisances projected
    out."""
    cosine: list[list[float]]
    """Cosines of what effects do, in their order."""

    def nats(self, a: str, b: str, sizes: dict[str, float]) -> float:
        """Expected lead of the true one of two rivals over the other, whichever is true.

        Where only one of them shows at all, it is there or it is not.
        """
        seen = [name for name in (a, b) if name in self.visible]
        apart = 1.0 - self.alike(a, b) ** 2
        return min((0.5 * self._sigma(name, sizes) ** 2 * apart for name in seen), default=0.0)

    def alike(self, a: str, b: str) -> float:
        """Cosine of what two effects do, 0 where one of them cannot show;
        1 where nothing is known of it.
        """
        if (a in self.visible) != (b in self.visible):
            return 0.0
        names = list(self.visible)
        return (
            self.cosine[names.index(max(a, b))][names.index(min(a, b))]
            if a in self.visible and a != b
            else 1.0
        )

    def _sigma(self, name: str, sizes: dict[str, float]) -> float:
        size, sigma = self.visible[name]
        return sigma * (sizes[name] / size if size > 0.0 and sizes.get(name) else 1.0)


def next_experiment(
    robot: Robot,
    sets: Sequence[tuple[str, ...]],
    rivals: Sequence[FoundEffect],
    rigs: Sequence[RigClaims] = (),
) -> NextExperiment | None:
    """The experiment that tells the effects of the first set apart;
    None where there is no set, or none does.

    `rivals` are fitted values, `rigs` what the logs claim (`meta.json`). A robot that was held is
    held again, as nothing shows its joints better; one that stood may be hung up.
    """
    if not sets:
        return None
    sizes = {
        name: size for name in sets[0] if math.isfinite(size := largest_distance(name, rivals))
    }
    pairs = list(combinations(sorted(sets[0]), 2))
    table = _table(robot, sets[0], rigs)

    def worth(name: str) -> float:
        # what the simulator does not know grows with the signal: of two equal leads the one on less
        # signal is safer
        return min(
            table[name].nats(*pair, sizes) * (1.0 - table[name].alike(*pair) ** 2) for pair in pairs
        )

    best = max(table, key=worth, default="")
    if not best or worth(best) <= 0.0:
        return None
    nats = min(table[best].nats(*pair, sizes) for pair in pairs)
    experiment = EXPERIMENTS[best]
    alike = max(table[best].alike(*pair) for pair in pairs)
    why = (
        f"{experiment.how}: there {' and '.join(sets[0])} look alike by {alike:.2f} only and are "
        "expected "
        f"{nats:.0f} nats apart; takes {experiment.duration_s(robot):.0f} s; "
        f"{experiment.limits.in_words()}"
    )
    return NextExperiment(name=best, why=why, expected_separation=nats)


def _table(
    robot: Robot, members: Sequence[str], rigs: Sequence[RigClaims]
) -> dict[str, EffectSeparations]:
    """Returns what each experiment shows that these rigs can do."""
    table = separations()
    if rigs and all(rig.get("base") == "fixed" for rig in rigs):
        table = {name: entry for name, entry in table.items() if EXPERIMENTS[name].base == "fixed"}
    camera = next((rig["camera"] for rig in rigs if "camera" in rig), None)
    of_camera = next(sensor.effects for sensor in SENSORS if sensor.name == "camera")
    if camera is None or not set(members) <= set(of_camera):
        return table
    seeing = [name for name, experiment in EXPERIMENTS.items() if experiment.camera]
    return {
        name: EffectSeparations(
            **measure_separations(EXPERIMENTS[name], robot, FootageCamera.of(camera))
        )
        for name in seeing
    }


@cache
def separations() -> dict[str, EffectSeparations]:
    """The measured table, by experiment."""
    measured = json.loads(SEPARATIONS.read_text(encoding="utf-8"))["experiments"]
    return {name: EffectSeparations(**entry) for name, entry in measured.items()}
