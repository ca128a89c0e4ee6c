"""Packages that not every installation has, by the extra of `pip install` that brings them."""

import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager

from saltus.errors import SaltusError


def install_command(extra: str) -> str:
    """The command that brings the packages of an extra."""
    return f"pip install 'saltus[{extra}]'"


@contextmanager
def packages_of(extra: str, what: str = "this") -> Iterator[None]:
    """Says in one line which package is missing to what is imported within.

    Raises:
        SaltusError: one is.
    """
    try:
        yield
    except ImportError as error:
        raise SaltusError(f"{what} needs {error.name}: {install_command(extra)}") from error


def check_package(package: str, extra: str, what: str) -> None:
    """Looks for a package before the work, without importing it.

    Raises:
        SaltusError: it is not there.
    """
    if importlib.util.find_spec(package) is None:
        raise SaltusError(
            f"{what} the package '{package}', which is not installed: {install_command(extra)}"
        )
