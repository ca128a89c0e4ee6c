"""Makes a row: a PNG, and a JSON with its numbers and what they stand on."""

import json
import math
from importlib import import_module
from pathlib import Path
from typing import Any

from saltus.errors import SaltusError, nearest_hint
from saltus.folders import ask_for_room
from saltus.models import ModelKind, model_id, model_path
from saltus.paper.ablations import ABLATIONS, FULL, TRAINED, measure, models_of
from saltus.paper.drawing import check_drawing, save
from saltus.paper.rows import ABLATION, BY_NAME, Row
from saltus.paper.runs import CAMERA, Effort
from saltus.provenance import commit

MODELS: tuple[ModelKind, ...] = ("policy", "heightmap")


def find_row(name: str) -> Row:
    """The row of that name; `SaltusError` where there is none."""
    if name not in BY_NAME:
        raise SaltusError(f"there is no row '{name}': {nearest_hint(name, [*BY_NAME, 'report'])}")
    return BY_NAME[name]


def is_makeable(row: Row, trained: Path) -> bool:
    """Whether all is there that a row needs."""
    if row.needs == ABLATION:
        return all((trained / name).is_dir() for name in _trainings(row))
    return bool(row.make)


def check_makeable(row: Row, folder: Path, trained: Path) -> None:
    """Before the work.

    Raises:
        SaltusError: the row cannot be made now; the message says what is missing. Or the folder cannot be written.
    """
    if row.needs == ABLATION:
        for name in _trainings(row):
            models_of(name, trained)
    elif not row.make:
        raise SaltusError(f"'{row.name}' is not made yet: {row.differs}")
    check_drawing()
    ask_for_room(folder)


def make(row: Row, effort: Effort, folder: Path, trained: Path = TRAINED) -> dict[str, Any]:
    """Makes FOLDER/NAME.png and .json of a row that `check_makeable` allows; returns what the latter holds."""
    if row.name in ABLATIONS:
        made = measure(row.name, effort, trained)
    else:
        module, function = row.make.split(".")
        more = (trained,) if row.needs == ABLATION else ()
        made = getattr(import_module(f"saltus.paper.{module}"), function)(effort, *more)
    result = {
        "row": row.name,
        "measured": "simulation",
        "commit": commit(),
        "models": _models(),
        "camera": CAMERA,
        "seeds": [effort.seeds[0], effort.seeds[: made.most_seeds][-1]],
        "configuration": made.configuration,
        "numbers": _finite(made.numbers),
    }
    save(made.figure, folder / f"{row.name}.png")
    (folder / f"{row.name}.json").write_text(json.dumps(result, indent=1) + "\n")
    return result


def made_before(row: Row, folder: Path) -> dict[str, Any] | None:
    """What `make` has written; None where it has not, or of other models than the shipped ones.

    Also for an ablation, of which more may have been trained since.

    Raises:
        SaltusError: the file holds something else.
    """
    path = folder / f"{row.name}.json"
    if row.needs == ABLATION or not path.exists() or not path.with_suffix(".png").exists():
        return None
    try:
        result: dict[str, Any] = json.loads(path.read_text())
        if (
            result["row"] != row.name
            or not isinstance(result["numbers"], dict)
            or not {"commit", "seeds"} <= set(result)
        ):
            raise ValueError(row.name)
        return result if result["models"] == _models() else None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SaltusError(f"{path} holds no row of the paper: remove it, or name another folder with --out") from error


def number_at(numbers: dict[str, Any], place: str) -> Any:
    """The number at a place with dots; None where there is none."""
    part: Any = numbers
    for name in place.split("."):
        part = part.get(name) if isinstance(part, dict) else None
    return part


def _trainings(row: Row) -> tuple[str, ...]:
    """Ablations without which a row that needs trained ones is not made."""
    return (row.name, FULL) if row.name in ABLATIONS else (FULL,)


def _models() -> dict[str, str]:
    """Names of the shipped networks."""
    return {kind: model_id(model_path(kind).read_bytes()) for kind in MODELS}


def _finite(value: Any) -> Any:
    """Numbers that are not finite become null, which JSON can say."""
    if isinstance(value, dict):
        return {name: _finite(part) for name, part in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value
