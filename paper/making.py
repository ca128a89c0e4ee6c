"""Makes a row: a PNG, and a JSON with its numbers and what they stand on."""

import json
import math
from importlib import import_module
from pathlib import Path
from typing import Any

from paper.ablations import (
    STAND_IN,
    TRANSFER,
    Places,
    apart,
    check_weights,
    compare,
    files_of,
    measure,
    shipped_in,
    shown_in,
    trained_systems,
    trainings_folder,
    trainings_of,
)
from paper.drawing import check_drawing, save
from paper.rows import ABLATION, BY_NAME, ROWS, Row
from paper.run_figures import Made
from paper.runs import Effort
from paper.training import CAMERA, FULL, PUBLISHED
from saltus.errors import SaltusError, nearest_hint
from saltus.folders import ask_for_room
from saltus.provenance import current_commit
from saltus.used_networks import ModelKind, model_id, model_path

MODELS: tuple[ModelKind, ...] = ("policy", "heightmap")
BEFORE_ROUNDING = {
    "a7c1dc5152f4f34d": "5fa42b0525ee938f",
    "455e38b683ebd676": "515308fb2ab442b7",
}
"""By a model's name that of the same network before its weights were kept in half precision, whose
results stand for it: on random images heights differ by 0.6 mm at most (models/heightmap.md), on
observations of runs plans by 0.04 % of their ranges (models/policy.md)."""


def find_row(name: str) -> Row:
    """The row of that name; `SaltusError` where there is none."""
    if name not in BY_NAME:
        raise SaltusError(f"there is no row '{name}': {nearest_hint(name, [*BY_NAME, 'report'])}")
    return BY_NAME[name]


def is_makeable(row: Row, trained: Path | None) -> bool:
    """True where all is there that a row needs."""
    if row.needs == ABLATION:
        there = trained_systems(trainings_folder(trained))
        return all(name in there for name in _needed(row, trained))
    return bool(row.make)


def check_makeable(row: Row, folder: Path, trained: Path | None) -> None:
    """Before the work.

    Raises:
        SaltusError: the row cannot be made now; the message says what is missing. Or the folder
            cannot be written.
    """
    if row.needs == ABLATION:
        for name in _needed(row, trained):
            files_of(name, trainings_folder(trained))
    elif not row.make:
        raise SaltusError(f"'{row.name}' is not made yet: {row.differs}")
    check_drawing()
    ask_for_room(folder)


def make(
    row: Row, effort: Effort, folder: Path, trained: Path | None = None, *, again: bool = True
) -> dict[str, Any]:
    """Makes FOLDER/NAME.png and .json of a row that `check_makeable` allows.

    Returns what the latter holds.

    What trainings of other systems came to that stand beside an ablation is taken from the folder
    or from what is published; so is, unless it shall be measured `again`, what its own came to. The
    others are measured.
    """
    trainings = trainings_folder(trained)
    if row.make:
        more = (trainings,) if row.needs == ABLATION else ()
        module, function = row.make.split(".")
        made: Made = getattr(import_module(f"paper.{module}"), function)(effort, *more)
        seeds = [effort.seeds[0], effort.seeds[: made.most_seeds][-1]]
    else:
        taken = {
            system: []
            if again and system == row.name
            else _measured(system, effort, folder, trainings)
            for system in shown_in(row.name, trainings)
        }
        for system, known in taken.items():
            check_weights(system, trainings, known)
        came_to = {
            system: measure(system, effort, trainings, known) for system, known in taken.items()
        }
        if row.name == TRANSFER:
            came_to = {name: {STAND_IN: places[STAND_IN]} for name, places in came_to.items()}
        made = compare(came_to, trainings)
        ran = [figures["trial_seeds"] for places in came_to.values() for figures in places.values()]
        seeds = [min(first for first, _ in ran), max(last for _, last in ran)]
    result = {
        "row": row.name,
        "measured": "simulation",
        "commit": current_commit(),
        "models": _models(),
        "camera": CAMERA,
        "seeds": seeds,
        "configuration": made.configuration,
        "numbers": _finite(made.numbers),
    }
    save(made.figure, folder / f"{row.name}.png")
    (folder / f"{row.name}.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return result


def _measured(system: str, effort: Effort, folder: Path, trainings: Path) -> list[Places | None]:
    """Returns what each training of a system came to by results in the folder or published ones.

    Taken are results with the shipped models that run in this system. Where that is all of them,
    and they ran the same trials, these may be others than those of `effort`; else nothing is taken
    of other trials, so that all of a system run the same.
    """
    folders = (folder, PUBLISHED)
    wanted, models, ran_with = trainings_of(system, trainings), _models(), shipped_in(system)
    taken: list[Places | None] = [None] * len(wanted)
    for row in (row for row in ROWS if row.needs == ABLATION and row.name != TRANSFER):
        for path in (place / f"{row.name}.json" for place in folders):
            result = _read(path, row) if path.exists() else None
            if result is None or any(
                result["models"].get(kind) not in (models[kind], BEFORE_ROUNDING.get(models[kind]))
                for kind in ran_with
            ):
                continue
            for training, places in _trainings_in(result, system):
                if training in wanted:
                    index = wanted.index(training)
                    taken[index] = taken[index] or places
    ran = [
        None if places is None else next(iter(places.values()))["trial_seeds"] for places in taken
    ]
    if None not in ran and all(trials == ran[0] for trials in ran):
        return taken
    usual = [effort.seeds[0], effort.seeds[-1]]
    return [places if trials == usual else None for places, trials in zip(taken, ran, strict=True)]


def _trainings_in(result: dict[str, Any], system: str) -> list[tuple[Any, Places]]:
    """The trainings of a system that a result holds, and what they came to.

    None of results in an older form.
    """
    try:
        return list(
            zip(
                result["configuration"]["trainings"][system],
                apart(result["numbers"][system]),
                strict=True,
            )
        )
    except (KeyError, TypeError, ValueError, StopIteration):
        return []


def made_before(row: Row, folder: Path) -> dict[str, Any] | None:
    """Reads what `make` has written; None where it has not,
    or of other models than the shipped ones.

    Also for an ablation: its picture shows other systems, of which more may have been trained
    since.

    Raises:
        SaltusError: the file holds something else.
    """
    path = folder / f"{row.name}.json"
    if row.needs == ABLATION or not path.exists() or not path.with_suffix(".png").exists():
        return None
    result = _read(path, row)
    return result if result["models"] == _models() else None


def _read(path: Path, row: Row) -> dict[str, Any]:
    """Reads what `make` has written; `SaltusError` where the file holds something else."""
    try:
        result: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if (
            result["row"] != row.name
            or not isinstance(result["numbers"], dict)
            or not {"commit", "seeds", "models", "configuration"} <= set(result)
        ):
            raise ValueError(row.name)
        return result
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SaltusError(
            f"{path} holds no row of the paper: remove it, or name another folder with --out"
        ) from error


def number_at(numbers: dict[str, Any], place: str) -> Any:
    """The number at a place with dots; None where there is none."""
    part: Any = numbers
    for name in place.split("."):
        part = part.get(name) if isinstance(part, dict) else None
    return part


def _needed(row: Row, trained: Path | None) -> tuple[str, ...]:
    """Systems without which a row that needs trainings is not made."""
    if row.make or row.name == TRANSFER:
        return (FULL,)
    return shown_in(row.name, trainings_folder(trained))


def _models() -> dict[str, str]:
    """Names of the shipped networks."""
    return {kind: model_id(model_path(kind).read_bytes()) for kind in MODELS}


def _finite(value: Any) -> Any:
    """Numbers that are not finite become null, which JSON can say."""
    if isinstance(value, dict):
        return {name: _finite(part) for name, part in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value
