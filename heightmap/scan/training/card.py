"""The card of a scan's network: what it is worth, and how anybody feeds its ONNX file."""

import json
from pathlib import Path

from saltus.heightmap.scan.network_inputs import MEASURED, MEMORY, NUMBERS
from saltus.heightmap.scan.training.evaluation import GROUPS, ScanScore
from saltus.heightmap.scan.training.settings import ScanTrainSettings

METHODS = ("network", "map 2 cm, drift, feet", "map 2 cm, feet", "map 4 cm", "flat")
"""In the order of the card's tables."""
_MEANING = (
    "Errors are means over flights that no training saw, after 1 s of motion. A point is seen if a "
    "ray ended "
    "within 3 cm of it, visible if one did in the last 0.2 s. Each entry: mean error [mm], share "
    "inside the "
    "90 % interval, median half-width [mm], share of all points."
)


def read_results(path: Path) -> list[ScanScore]:
    """Scores that `saltus.heightmap.scan.training.evaluation.write_results` wrote."""
    return [ScanScore(**table) for table in json.loads(path.read_text(encoding="utf-8"))]


def scan_card(
    model_id: str,
    settings: ScanTrainSettings,
    scores: list[ScanScore],
    parameters: int,
    images: int,
    commit: str,
) -> str:
    """The card of a model file as Markdown; `commit` says which code trained last."""
    trained = (
        f"{images / 1e6:.1f} million images, seed {settings.seed}, {parameters:,} parameters, "
        f"commit {commit}"
    )
    rows = list(dict.fromkeys(score.row for score in scores))
    parts = [
        f"# Scan model {model_id}: heights in two dimensions",
        f"Trained without physics on cameras that fly over random ground: {trained}.",
        _MEANING,
        *(_table(row, grid, scores) for grid in ("scan", "line") for row in rows),
        _families(scores),
        _feeding(settings),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _table(row: str, grid: str, scores: list[ScanScore]) -> str:
    found = {
        (s.method, s.group): s for s in scores if (s.row, s.grid, s.family) == (row, grid, "every")
    }
    if not found:
        return ""
    points = "187 points, 1.6 x 1.0 m" if grid == "scan" else "30 points, -0.4 to 0.8 m ahead"
    lines = [
        f"## {row[0].upper()}{row[1:]}: {points}",
        "",
        f"| | {' | '.join(GROUPS)} |",
        "|---" * 6 + "|",
    ]
    for method in METHODS:
        cells = [_cell(found.get((method, group)), method) for group in GROUPS]
        lines.append(f"| {method} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(score: ScanScore | None, method: str) -> str:
    if score is None:
        return ""
    if method == "flat":
        return f"{score.error_mm:.1f}"
    inside, share = 100 * score.inside, 100 * score.share
    return f"{score.error_mm:.1f}, {inside:.0f} %, {score.half_width_mm:.0f}, {share:.0f} %"


def _families(scores: list[ScanScore]) -> str:
    found = {
        (s.family, s.method, s.group): s for s in scores if (s.row, s.grid) == ("usual", "scan")
    }
    families = [
        f
        for f in dict.fromkeys(s.family for s in scores)
        if f != "every" and (f, "network", "all") in found
    ]
    if not families:
        return ""
    lines = [
        "## By kind of ground: the scan, seen and never seen [mm], and share inside",
        "",
        "| | network | inside | best map | network, never seen | best map, never seen |",
        "|---" * 6 + "|",
    ]
    for family in families:
        errors = [
            found.get((family, method, group))
            for method, group in (
                ("network", "seen"),
                (METHODS[1], "seen"),
                ("network", "never"),
                (METHODS[1], "never"),
            )
        ]
        numbers = [f"{score.error_mm:.1f}" if score else "" for score in errors]
        inside = f"{100 * errors[0].inside:.0f} %" if errors[0] else ""
        lines.append(f"| {family} | {numbers[0]} | {inside} | {' | '.join(numbers[1:])} |")
    return "\n".join(lines)


def _feeding(settings: ScanTrainSettings) -> str:
    side, fine = settings.map.side, settings.map.fine_m
    shape = f"{side}, {side}"
    return f"""## How to feed the file

One call per image; all arrays are single precision with a leading dimension of robots, heights in
metres. The window has {side} x {side} cells of {100 * fine:g} cm, along the axes of the odometry, rows along x,
and follows the base by whole steps of {100 * settings.map.cell_m:g} cm. Positions are the odometry's, corrected
for drift by the map's law (`saltus/heightmap/scan/elevation.py`; its numbers are in the file's metadata
`map`, as TOML).

| input | shape | what |
|---|---|---|
| `filled` | n, {shape} | the map, filled where it knows nothing, above the ground under the base |
| `measured` | n, {len(MEASURED)}, {shape} | {", ".join(MEASURED)} |
| `memory` | n, {len(MEMORY)}, {shape} | {", ".join(MEMORY)}: of the last call, moved with the window |
| `numbers` | n, {len(NUMBERS)} | {", ".join(NUMBERS)} |

Heights of `measured` and `memory` are above `filled`; a half-width of 1 m says that nothing was told.
`saltus/heightmap/scan/network_inputs.py` says the unit of each. The file returns `height` above
`filled` and `half_width`, half of the 90 % interval; in between cells both are bilinear."""
