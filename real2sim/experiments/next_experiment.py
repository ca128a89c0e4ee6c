"""Which experiment would tell the effects of a set apart.

What one unit of every effect does to the whitened residuals of each experiment, and how alike two
effects look there, was measured once on a robot without effects
(`saltus.real2sim.experiments.separations`). How far two fitted rivals are expected to be apart
follows without any simulation. For effects of a camera the experiments are measured anew with the
claimed camera: one that looks down hardly sees a wall.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations

from saltus.real2sim.experiments.menu import EXPERIMENTS, SEPARATIONS
from saltus.real2sim.search.findings import FoundEffect
from saltus.real2sim.sensors import SENSORS
from saltus.real2sim.verdict import NextExperiment, largest
from saltus.recordings.rig_claims import RigClaims
from saltus.robots.robot import Robot


@dataclass(frozen=True, kw_only=True)
class Separations:
    """Separations that one experiment shows."""

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
    sizes = {name: size for name in sets[0] if math.isfinite(size := largest(name, rivals))}
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
) -> dict[str, Separations]:
    """Returns what each experiment shows that these rigs can do."""
    table = separations()
    if rigs and all(rig.get("base") == "fixed" for rig in rigs):
        table = {name: entry for name, entry in table.items() if EXPERIMENTS[name].base == "fixed"}
    camera = next((rig["camera"] for rig in rigs if "camera" in rig), None)
    of_camera = next(sensor.effects for sensor in SENSORS if sensor.name == "camera")
    if camera is None or not set(members) <= set(of_camera):
        return table
    from saltus.real2sim.experiments.footage import FootageCamera
    from saltus.real2sim.experiments.separations import measure

    seeing = [name for name, experiment in EXPERIMENTS.items() if experiment.camera]
    return {
        name: Separations(**measure(EXPERIMENTS[name], robot, FootageCamera.of(camera)))
        for name in seeing
    }


@cache
def separations() -> dict[str, Separations]:
    """The measured table, by experiment."""
    measured = json.loads(SEPARATIONS.read_text(encoding="utf-8"))["experiments"]
    return {name: Separations(**entry) for name, entry in measured.items()}
