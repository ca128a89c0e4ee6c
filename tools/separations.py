"""Measures what each experiment of the menu shows of each effect,
on the reference robot, and writes the table.

    python tools/separations.py [experiment ...]

`saltus.real2sim.experiments.next_experiment` reads it.
"""

import json
import sys

from saltus.real2sim.experiments.menu import EXPERIMENTS, SEPARATIONS
from saltus.real2sim.experiments.next_experiment import measure_separations
from saltus.robots.loading import reference_robot


def main(names: list[str]) -> None:
    """Measures experiments, all where none is named; the others stay as they are in the table."""
    robot = reference_robot()
    measured = (
        json.loads(SEPARATIONS.read_text(encoding="utf-8"))["experiments"]
        if SEPARATIONS.exists()
        else {}
    )
    for name in names or list(EXPERIMENTS):
        measured[name] = measure_separations(EXPERIMENTS[name], robot)
        kept = {known: measured[known] for known in EXPERIMENTS if known in measured}
        SEPARATIONS.write_text(table(kept), encoding="utf-8")


def table(experiments: dict[str, object]) -> str:
    """JSON with a line for each experiment."""
    lines = ",\n".join(
        json.dumps({name: e}, separators=(",", ":"))[1:-1] for name, e in experiments.items()
    )
    return f'{{"source": "python tools/separations.py", "experiments": {{\n{lines}\n}}}}\n'


if __name__ == "__main__":
    main(sys.argv[1:])
