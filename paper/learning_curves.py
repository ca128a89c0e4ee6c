"""Learning curves of the paper's trainings: of the full policy by experience,
of what sees by updates.
"""

import lzma
from pathlib import Path

import numpy as np

from paper.ablations import files_of, trainings_of
from paper.drawing import OURS, legend, subplots
from paper.run_figures import Made
from paper.runs import Effort
from paper.training import FULL, IMITATION, NO_LATENCY, PREDICTOR
from saltus.arrays import Floats
from saltus.errors import SaltusError
from saltus.policy.training.files import PROGRESS

_NETWORKS = {
    PREDICTOR: ("predictor, cm", 100.0),
    NO_LATENCY: ("without delay, cm", 100.0),
    IMITATION: ("imitated plans, % of range", 50.0),
}
"""Curves that are drawn of a network's training: its error on the windows that it is shown; plans
lie within [-1, 1]."""


def learning_curves(_: Effort, trained: Path) -> Made:
    """Curves of each training of the full system by experience,
    and of the networks that see by updates.
    """
    columns = {
        "reward": "reward of an iteration",
        "stairs/level": "stairs",
        "stepping_stones/level": "stones",
    }
    columns |= {"step/level": "step", "gap/level": "gap"}
    curves = [_progress(policy.parent / PROGRESS) for (policy,) in files_of(FULL, trained)]
    errors = _errors(trained)
    figure, (axes, below) = subplots(2, len(columns), 4.6, sharex="row")
    shortest = min(curves, key=lambda curve: len(curve["steps"]))
    million = 1e-6 * shortest["steps"]
    for axis, (column, title) in zip(axes, columns.items(), strict=True):
        values = np.array(
            [np.interp(shortest["steps"], curve["steps"], curve[column]) for curve in curves]
        )
        axis.fill_between(
            million, values.min(axis=0), values.max(axis=0), color=OURS, alpha=0.3, linewidth=0
        )
        axis.plot(million, values.mean(axis=0), color=OURS)
        axis.set_title(
            f"{title}{', level' if column.endswith('level') else ''}", loc="left", fontsize=9
        )
        axis.set_xlabel("million steps")
    for axis in below[len(_NETWORKS) :]:
        axis.set_axis_off()
    for axis, (part, (title, unit)) in zip(below, _NETWORKS.items(), strict=False):
        for name, curve in errors[part].items():
            axis.plot(curve["update"], unit * curve["error"], label=name, linewidth=0.8)
        axis.set_ylim(bottom=0.0)
        axis.set_title(title, loc="left", fontsize=9)
        axis.set_xlabel("updates")
    legend(below[0], fontsize=7)
    numbers = {
        "seeds": len(curves),
        "million_steps": [round(float(1e-6 * curve["steps"][-1]), 1) for curve in curves],
        "minutes": [round(float(curve["seconds"][-1]) / 60.0, 1) for curve in curves],
        "at_the_end": {
            column: [round(float(curve[column][-1]), 2) for curve in curves] for column in columns
        },
        "networks": {
            part: {name: _tenths(unit * curve["error"]) for name, curve in errors[part].items()}
            for part, (_, unit) in _NETWORKS.items()
        },
    }
    configuration = {
        "band": "least to greatest of the seeds; line: mean",
        "networks": "least seed; mean error in the last but one tenth of a training, "
        "and in the last: " + ", ".join(title for title, _ in _NETWORKS.values()),
        "trainings": {FULL: trainings_of(FULL, trained)},
    }
    return Made(numbers=numbers, figure=figure, configuration=configuration)


def _errors(trained: Path) -> dict[str, dict[str, dict[str, Floats]]]:
    """Errors of the networks of the least seed by updates:
    of each that is trained its parts, by name.
    """
    found: dict[str, dict[str, dict[str, Floats]]] = {part: {} for part in _NETWORKS}
    for part, curves in found.items():
        for path in sorted((trained / part).glob(f"seed-*/{PROGRESS}*"))[:1]:
            columns = _columns(path.with_name(PROGRESS))
            for name in dict.fromkeys(columns["network"]):
                mine = np.array([each == name for each in columns["network"]])
                shown = (
                    f"round {int(name.removeprefix('round-')) + 1}" if part == PREDICTOR else part
                )
                curves[shown] = {
                    key: np.array(columns[key], float)[mine] for key in ("update", "error")
                }
    return found


def _tenths(error: Floats) -> list[float]:
    """Means of the last but one tenth, and of the last."""
    tenth = max(1, len(error) // 10)
    return [
        round(float(np.mean(error[-2 * tenth : -tenth])), 3),
        round(float(np.mean(error[-tenth:])), 3),
    ]


def _progress(path: Path) -> dict[str, Floats]:
    """The columns of a policy's table."""
    return {name: np.array(column, float) for name, column in _columns(path).items()}


def _columns(path: Path) -> dict[str, tuple[str, ...]]:
    """The columns of a training's table, as it was written or packed by xz;
    `SaltusError` where there is none.
    """
    packed = path.with_name(f"{path.name}.xz")
    try:
        text = path.read_bytes() if path.exists() else lzma.decompress(packed.read_bytes())
        names, *rows = (line.split(",") for line in text.decode().splitlines())
        return dict(zip(names, zip(*rows, strict=True), strict=True))
    except (OSError, ValueError, lzma.LZMAError) as error:
        raise SaltusError(f"cannot read {path}, the table of a training") from error
