"""Where results go and how they are printed."""

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from saltus.errors import SaltusError
from saltus.folders import new_folder

if TYPE_CHECKING:
    from saltus.runtime.stack import Stack

PROGRESS_PERIOD_S = 0.2


def run_directory(command: str, out: Path | None) -> Path:
    """The folder of this run: `out`, or a new `runs/<date>-<command>`. It is made here.

    Raises:
        SaltusError: it cannot be made.
    """
    path = out or new_folder(command)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SaltusError(f"cannot make the folder '{path}' ({error.strerror}): name another with --out") from error
    return path


def follow(stack: "Stack") -> Iterator[None]:
    """Yields five times a second until the run is over; says on stderr, once, that the computer does not keep up."""
    told = False
    while not stack.wait(PROGRESS_PERIOD_S * stack.config.speed):
        if stack.too_slow is not None and not told:
            tqdm.write(f"saltus: {stack.too_slow}", file=sys.stderr)
            told = True
        yield


def print_json(table: dict[str, Any]) -> None:
    """Prints one JSON object on one line; numbers that are not finite become null."""
    print(json.dumps(finite(table)), flush=True)


def finite(value: Any) -> Any:
    """`value` with NaN and infinities replaced by None, which JSON can say."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return value
