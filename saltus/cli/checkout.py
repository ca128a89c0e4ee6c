"""Rooms beside the product, which a checkout has and a wheel lacks: benchmarks/ and paper/."""

import sys
from pathlib import Path

from saltus.errors import SaltusError

SOURCE = Path(__file__).resolve().parents[2]
"""The checkout, where this is one."""


def checkout_root(file: str, command: str) -> Path:
    """Root of the checkout that runs, or of the one around, where saltus is installed from a wheel.

    It is importable from then on, also by processes that are started.

    Args:
        file: A file that it has and that nobody else has, relative to its root.
        command: The command that needs it.

    Raises:
        SaltusError: there is none.
    """
    for root in (SOURCE, Path.cwd()):
        if (root / file).is_file():
            if str(root) not in sys.path:
                sys.path.insert(0, str(root))
            return root
    folder = file.split("/")[0]
    raise SaltusError(
        f"{folder}/ is not in the installed package: run `saltus {command}` in a checkout of saltus"
    )
