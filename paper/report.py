"""One page about the paper: what it shows, in words of our own,
ours drawn, and numbers side by side.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from paper.ablations import ROUNDS_ROW, SIMULATION, STAND_IN
from paper.making import number_at
from paper.rows import ABLATION, ROWS, Row
from saltus.policy.evaluation.evaluate import success_interval
from saltus.reports.page import render_page, write_page

PLACES = (SIMULATION, STAND_IN)


def write_report(results: Mapping[str, dict[str, Any]], folder: Path) -> Path:
    """Writes FOLDER/report.html of rows that `paper.making` made there, by name.

    Returns its path.
    """
    path = folder / "report.html"
    text = render_page(
        __file__,
        rows=ROWS,
        results=results,
        folder=folder,
        worth=_worth(results),
        side_by_side=_side_by_side,
        flat=_flat,
        provenance=_provenance,
    )
    write_page(path, text)
    return path


def _worth(results: Mapping[str, dict[str, Any]]) -> list[tuple[str, ...]]:
    """Returns what each part of the system is worth, of all that stands in rows of ablations."""
    systems: dict[str, Any] = {}
    against: dict[str, str] = {}
    for row in (
        row for row in ROWS if row.needs == ABLATION and not row.make and row.name in results
    ):
        numbers = results[row.name]["numbers"]
        for name, places in numbers.items():
            systems[name] = systems.get(name, {}) | places
        if row.name in numbers and len(numbers) > 1:
            against[row.name] = next(other for other in numbers if other != row.name)
        elif row.name == ROUNDS_ROW:
            *earlier, last = numbers
            against |= dict.fromkeys(earlier, last)
    return [
        (
            name,
            against.get(name, "-"),
            *(_successes(places[where]) if where in places else "-" for where in PLACES),
            _difference(places, systems[against[name]]) if name in against else "-",
        )
        for name, places in systems.items()
    ]


def _difference(places: Mapping[str, Any], others: Mapping[str, Any]) -> str:
    """Difference of the shares of successes [percentage points],
    in each of `PLACES` that both have.
    """
    both = [where for where in PLACES if where in places and where in others]
    return ", ".join(
        f"{100.0 * (_share(places[where]) - _share(others[where])):+.0f}" for where in both
    )


def _share(figures: Mapping[str, Any]) -> float:
    return float(sum(figures["success"]) / (figures["trials"] * len(figures["success"])))


def _successes(figures: Mapping[str, Any]) -> str:
    low, high = figures["interval95_percent"]
    count = figures["trials"] * len(figures["success"])
    each = f"; seeds {_text(figures['success'])}" if len(figures["success"]) > 1 else ""
    return f"{sum(figures['success'])} of {count} ({low:.0f} to {high:.0f} %){each}"


def _side_by_side(row: Row, result: dict[str, Any] | None) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for number in row.numbers:
        ours = (
            number_at(result["numbers"], number.ours)
            if result is not None and number.ours
            else None
        )
        said = "-" if ours is None else f"{_text(ours)} {number.unit}".strip()
        if ours is not None and number.ours.endswith(".success") and result is not None:
            trials = number_at(result["numbers"], number.ours.replace("success", "trials"))
            low, high = (100.0 * share for share in success_interval(ours, trials))
            said += f" of {trials} ({low:.0f} to {high:.0f} %)"
        rows.append(
            (number.what, number.paper, number.source, said, "-" if ours is None else "simulation")
        )
    return rows


def _flat(numbers: Mapping[str, Any], before: str = "") -> list[tuple[str, str]]:
    """One line for each number; least, median and most of one share a line."""
    rows = []
    for name, value in numbers.items():
        place = f"{before}{name}"
        if isinstance(value, dict) and value.keys() != {"least", "median", "most"}:
            rows += _flat(value, f"{place}, ")
        else:
            between = " to " if name.startswith("interval") or name.endswith("seeds") else ", "
            rows.append((place.replace("_", " "), _text(value, between)))
    return rows


def _text(value: Any, between: str = ", ") -> str:
    if isinstance(value, dict):
        return f"{_text(value['median'])} ({_text(value['least'])} to {_text(value['most'])})"
    if isinstance(value, list):
        return between.join(map(_text, value))
    return f"{value:.4g}" if isinstance(value, float) else "-" if value is None else str(value)


def _provenance(row: Row, result: dict[str, Any]) -> str:
    trainings = result["configuration"].get("trainings")
    if (
        trainings is not None and not row.make
    ):  # what ran, and which code, is said of each system among its numbers
        ran = ", ".join(
            f"{system} {' '.join(known['policy'] for known in seeds)}"
            for system, seeds in trainings.items()
        )
        return (
            f"{row.trial}; policies {ran}; drawn by commit {result['commit']}; "
            f"saltus paper {row.name}"
        )
    models = ", ".join(f"{kind} {name}" for kind, name in result["models"].items())
    seeds = f"seeds {result['seeds'][0]} to {result['seeds'][1]}"
    how = f"{row.trial}; " if row.trial else ""
    return f"{how}{seeds}; {models}; commit {result['commit']}; saltus paper {row.name}"
