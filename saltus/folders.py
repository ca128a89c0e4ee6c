"""The folder of a run: a new one unless told otherwise,
asked for room before the work, never that of two trainings.
"""

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from saltus.errors import SaltusError

RUNS = Path("runs")


def new_folder(command: str) -> Path:
    """A folder that is not there yet: `runs/<date>-<command>`; it is not made here."""
    name = f"{datetime.now():%Y-%m-%dT%H%M%S}-{command}"
    return next(
        path
        for path in (RUNS / f"{name}{'-' * bool(n)}{n or ''}" for n in range(10_000))
        if not path.exists()
    )


@dataclass(frozen=True, kw_only=True)
class SettingDifference:
    """A setting that is not the same in two configurations, as when a run is to be resumed with
    others.
    """

    name: str
    """With the tables that it stands in: "learning.desired_kl"."""
    before: object
    now: object


def setting_differences(
    before: Mapping[str, object], now: Mapping[str, object], where: str = ""
) -> Iterator[SettingDifference]:
    """Differences between two configurations, each as nested tables.

    A value that one lacks is None there.
    """
    for name in (*now, *(name for name in before if name not in now)):
        left, right = before.get(name), now.get(name)
        if isinstance(left, Mapping) and isinstance(right, Mapping):
            yield from setting_differences(left, right, f"{where}{name}.")
        elif left != right:
            yield SettingDifference(name=f"{where}{name}", before=left, now=right)


def ask_for_room(folder: Path) -> None:
    """Makes a folder and finds out before the work whether results can be written into it,
    else `SaltusError`.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise SaltusError(
            f"cannot write into the folder '{folder}' ({error.strerror}): name another with --out"
        ) from error


def another_training(
    checkpoint: Path, before: Mapping[str, object], now: Mapping[str, object]
) -> SaltusError:
    """The error of a training that would write over the checkpoint of another one.

    It says what differs.
    """
    differs = ", ".join(
        f"{d.name} = {d.before}, not {d.now}" for d in setting_differences(before, now)
    )
    return SaltusError(
        f"{checkpoint} is of another training ({differs or 'of the same configuration'}): go on "
        "from it with "
        f"--resume {checkpoint}, or name another folder with --out"
    )
