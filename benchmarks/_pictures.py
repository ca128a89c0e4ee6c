"""Pictures of what was measured. They need matplotlib; benchmarks without a picture do not."""

import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks._command import Command
from saltus.errors import SaltusError


@dataclass(frozen=True, kw_only=True)
class Pictured(Command):
    """A benchmark that can draw what it measured.

    Raises:
        SaltusError: a picture is asked for, and matplotlib is not installed.
    """

    picture: Path | None = None
    """PNG to draw the figures into; needs matplotlib."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.picture is not None and importlib.util.find_spec("matplotlib") is None:
            raise SaltusError(
                "--picture needs matplotlib, which is not installed: pip install matplotlib"
            )


def subplots(rows: int, columns: int, **options: Any) -> tuple[Any, Any]:
    """A figure and its axes, as matplotlib's function of this name makes them, without a screen."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    return plt.subplots(rows, columns, layout="constrained", **options)


def save(figure: Any, path: Path) -> None:
    """Writes a figure as PNG, and forgets it."""
    from matplotlib import pyplot as plt

    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)
    plt.close(figure)
