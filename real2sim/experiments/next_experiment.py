"""Which experiment would tell the effects of a set apart.

How well each experiment of the menu does it was measured once, on a robot without effects
(`real2sim.experiments.separations` measures it again): what one unit of every effect does to the whitened residuals of
its log, and how alike two effects look there. What two fitted rivals are expected to be apart follows from that without
any simulation.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache
from itertools import permutations
from pathlib import Path

from real2sim.experiments.menu import EXPERIMENTS
from real2sim.search.findings import FoundEffect
from real2sim.verdict import NextExperiment
from saltus.effects.registry import EFFECTS

TABLE = Path(__file__).parent / "separations.json"


@dataclass(frozen=True, kw_only=True)
class Visibility:
    """What an effect does to the log of an experiment."""

    size: float
    """Of the effect in its first parameter, as deviation from null, or 0 where that is infinite."""
    sigma: float
    """Norm of what this size changes in the whitened residuals, nuisances projected out."""


@dataclass(frozen=True, kw_only=True)
class Separations:
    """What one experiment shows."""

    visible: dict[str, Visibility]
    cosine: dict[tuple[str, str], float]

    def nats(self, a: str, b: str, sizes: dict[str, float]) -> float:
        """Expected lead of the true one of two rivals over the other, whichever is true."""
        if a not in self.visible or b not in self.visible:
            return 0.0
        return min(0.5 * self._sigma(name, sizes) ** 2 * (1.0 - self.alike(a, b) ** 2) for name in (a, b))

    def alike(self, a: str, b: str) -> float:
        """Cosine of what two effects do; 1 where one of them does nothing."""
        return self.cosine.get((min(a, b), max(a, b)), 1.0)

    def _sigma(self, name: str, sizes: dict[str, float]) -> float:
        seen = self.visible[name]
        share = abs(sizes[name]) / seen.size if seen.size > 0.0 and sizes.get(name) else 1.0
        return seen.sigma * share


def next_experiment(sets: Sequence[tuple[str, ...]], rivals: Sequence[FoundEffect]) -> NextExperiment | None:
    """The experiment that tells the effects of the first set apart; None where there is no set, or none does.

    Args:
        sets: Effects that could not be told apart.
        rivals: Their fitted values, where they are known.
    """
    if not sets:
        return None
    sizes = _sizes(rivals)
    pairs = [pair for pair in permutations(sorted(sets[0]), 2) if pair[0] < pair[1]]
    table = separations()

    def worth(name: str) -> float:
        # what the simulator does not know grows with the signal: of two equal leads the one on less signal is safer
        return min(table[name].nats(*pair, sizes) * (1.0 - table[name].alike(*pair) ** 2) for pair in pairs)

    best = max(table, key=worth, default="")
    if not best or worth(best) <= 0.0:
        return None
    nats = min(table[best].nats(*pair, sizes) for pair in pairs)
    experiment = EXPERIMENTS[best]
    alike = max(table[best].alike(*pair) for pair in pairs)
    why = (
        f"{experiment.how}: there {' and '.join(sets[0])} look alike by {alike:.2f} only and are expected "
        f"{nats:.0f} nats apart; takes {experiment.duration_s:.0f} s; {experiment.limits.in_words()}"
    )
    return NextExperiment(name=best, why=why, expected_separation=nats)


@cache
def separations() -> dict[str, Separations]:
    """The measured table, by experiment."""
    return {name: _separations(entry) for name, entry in json.loads(TABLE.read_text())["experiments"].items()}


def _separations(entry: dict[str, dict[str, list[float]] | list[list[float]]]) -> Separations:
    visible = dict(entry["visible"])  # type: ignore[arg-type]
    names = list(visible)
    return Separations(
        visible={name: Visibility(size=size, sigma=sigma) for name, (size, sigma) in visible.items()},
        cosine={
            (min(a, b), max(a, b)): entry["cosine"][i][j]  # type: ignore[index]
            for i, a in enumerate(names)
            for j, b in enumerate(names)
            if i != j
        },
    )


def _sizes(rivals: Sequence[FoundEffect]) -> dict[str, float]:
    """How far the fitted first parameter of each effect is from null, at the place where it is farthest."""
    sizes: dict[str, float] = {}
    for rival in rivals:
        name, found = next(iter(rival.params.items()))
        null = next((f.metadata["null"] for f in fields(EFFECTS[rival.name]) if f.name == name), math.nan)
        size = abs(found.value - null) if isinstance(null, int | float) else math.nan
        if math.isfinite(size):
            sizes[rival.name] = max(sizes.get(rival.name, 0.0), size)
    return sizes
