"""Which code made a result."""

import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path


def current_commit() -> str:
    """The commit of the checkout that runs, with "+" where files are changed.

    The version outside a checkout.
    """
    root = Path(__file__).resolve().parent.parent
    if not (root / ".git").exists():  # an installed package may lie in somebody else's checkout
        return f"version {package_version('saltus')}"
    command = ["git", "describe", "--always", "--dirty=+", "--abbrev=40", "--exclude=*"]
    try:
        described = subprocess.run(
            command,
            cwd=root,
            capture_output=True,
            text=True,
            check=True,
            timeout=10,
            encoding="utf-8",
        )
    except (OSError, subprocess.SubprocessError):
        return f"version {package_version('saltus')}"
    return described.stdout.strip()


def package_version(name: str) -> str:
    """Installed version of a package, "missing" where there is none."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "missing"
