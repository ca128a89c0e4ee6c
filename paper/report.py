"""One page about the paper: what it shows, in words of our own, ours drawn, and numbers side by side."""

import base64
import html
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from paper.ablations import ROUNDS_ROW, SIMULATION, STAND_IN
from paper.making import number_at
from paper.rows import ABLATION, ROWS, Row
from saltus.policy.evaluation.evaluate import success_interval
from saltus.recordings.page import page, table, write_page

STYLE = "img { max-width: 100%; } summary { cursor: pointer; color: #555; } .why { max-width: 60em; }"
PLACES = (SIMULATION, STAND_IN)
HEAD = ("what", "the paper", "measured on", "Saltus", "measured in")
INTRODUCTION = (
    "The paper's numbers are those of the machine that its column names, mostly a real robot. <b>All of Saltus's are "
    "simulation</b>: MuJoCo, the shipped policy and predictor, in the ablations what was trained for them, late images "
    "of a D435i with its errors. Start, friction, payload, strength of the motors and delays are drawn for each trial. "
    "They stand beside each other and are no comparison of like with like. The paper ran its ablations on a robot, "
    "too. Here another simulated robot takes its place, the <b>stand-in</b>: it has ten effects, such as weak drives, "
    "friction in the joints, soft feet and later images, each beyond what the trainings draw."
)
WORTH = (
    "Successes on 14 stairs of 0.20 m. Each system lacks one part of that which it is held against, no-sysid two; "
    "imitation has plans from images in the place of heights and policy. Systems above round 3 see with the shipped "
    "predictor; round 3 and those below with what was trained for these rows on the same data: no-latency, no-sysid "
    "and imitation with as many updates as the three rounds together. Differences are of the shares of successes, in "
    "simulation and on the stand-in, in percentage points."
)


def write_report(results: Mapping[str, dict[str, Any]], folder: Path) -> Path:
    """Writes FOLDER/report.html of rows that `paper.making` made there, by name; returns its path."""
    body = [
        "<h1>Agile Continuous Jumping in Discontinuous Terrains, made again</h1>",
        f"<p>{INTRODUCTION}</p>",
        *_worth(results),
        f"<p>{len(results)} of {len(ROWS)} rows are made; what is not made says what it needs.</p>",
        *(_row(row, results.get(row.name), folder) for row in ROWS),
    ]
    path = folder / "report.html"
    write_page(path, page("Saltus: the paper made again", "\n".join(body), STYLE))
    return path


def _worth(results: Mapping[str, dict[str, Any]]) -> list[str]:
    """What each part of the system is worth, of all that stands in rows of ablations."""
    systems: dict[str, Any] = {}
    against: dict[str, str] = {}
    for row in (row for row in ROWS if row.needs == ABLATION and not row.make and row.name in results):
        numbers = results[row.name]["numbers"]
        for name, places in numbers.items():
            systems[name] = systems.get(name, {}) | places
        if row.name in numbers and len(numbers) > 1:
            against[row.name] = next(other for other in numbers if other != row.name)
        elif row.name == ROUNDS_ROW:
            *earlier, last = numbers
            against |= dict.fromkeys(earlier, last)
    rows = [
        (
            name,
            against.get(name, "-"),
            *(_successes(places[where]) if where in places else "-" for where in PLACES),
            _difference(places, systems[against[name]]) if name in against else "-",
        )
        for name, places in systems.items()
    ]
    head = ("system", "held against", "in simulation", "on the stand-in", "difference")
    return ["<h2>What each part is worth</h2>", f"<p>{WORTH}</p>", table(head, rows, "text")] if rows else []


def _difference(places: Mapping[str, Any], others: Mapping[str, Any]) -> str:
    """Of the shares of successes [percentage points], in each of `PLACES` that both have."""
    both = [where for where in PLACES if where in places and where in others]
    return ", ".join(f"{100.0 * (_share(places[where]) - _share(others[where])):+.0f}" for where in both)


def _share(figures: Mapping[str, Any]) -> float:
    return float(sum(figures["success"]) / (figures["trials"] * len(figures["success"])))


def _successes(figures: Mapping[str, Any]) -> str:
    low, high = figures["interval95_percent"]
    count = figures["trials"] * len(figures["success"])
    each = f"; seeds {_text(figures['success'])}" if len(figures["success"]) > 1 else ""
    return f"{sum(figures['success'])} of {count} ({low:.0f} to {high:.0f} %){each}"


def _row(row: Row, result: dict[str, Any] | None, folder: Path) -> str:
    parts = [
        f"<h2 id={row.name}>{row.where}: {row.name}</h2>",
        f"<p><b>The paper:</b> {html.escape(row.shows)}</p>",
    ]
    if row.numbers:
        parts.append(table(HEAD, _side_by_side(row, result), "text"))
    if result is None:
        return "\n".join([*parts, f"<p class=bad>Not made ({row.needs}): {html.escape(row.missing)}</p>"])
    if row.differs:
        parts.append(f"<p class=why><b>Where ours differs:</b> {html.escape(row.differs)}</p>")
    picture = base64.b64encode((folder / f"{row.name}.png").read_bytes()).decode()
    shown = table(("number", "Saltus, simulation"), _flat(result["numbers"]), "text")
    return "\n".join(
        [
            *parts,
            f'<img src="data:image/png;base64,{picture}" alt="{row.name}, simulated">',
            f"<details><summary>all numbers of ours</summary>{shown}</details>",
            f"<p class=note>{html.escape(_provenance(row, result))}</p>",
        ]
    )


def _side_by_side(row: Row, result: dict[str, Any] | None) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for number in row.numbers:
        ours = number_at(result["numbers"], number.ours) if result is not None and number.ours else None
        said = "-" if ours is None else f"{_text(ours)} {number.unit}".strip()
        if ours is not None and number.ours.endswith(".success") and result is not None:
            trials = number_at(result["numbers"], number.ours.replace("success", "trials"))
            low, high = (100.0 * share for share in success_interval(ours, trials))
            said += f" of {trials} ({low:.0f} to {high:.0f} %)"
        rows.append((number.what, number.paper, number.source, said, "-" if ours is None else "simulation"))
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
    if trainings is not None and not row.make:  # what ran, and which code, is said of each system among its numbers
        ran = ", ".join(
            f"{system} {' '.join(known['policy'] for known in seeds)}" for system, seeds in trainings.items()
        )
        return f"{row.trial}; policies {ran}; drawn by commit {result['commit']}; saltus paper {row.name}"
    models = ", ".join(f"{kind} {name}" for kind, name in result["models"].items())
    seeds = f"seeds {result['seeds'][0]} to {result['seeds'][1]}"
    how = f"{row.trial}; " if row.trial else ""
    return f"{how}{seeds}; {models}; commit {result['commit']}; saltus paper {row.name}"
