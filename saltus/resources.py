"""Files that Saltus ships: models and Zenoh configurations."""

from pathlib import Path

from saltus.errors import SaltusError


def shipped_file(name: str) -> Path:
    """Path of a shipped file, e.g. `shipped_file("models/heightmap.onnx")`; `SaltusError`
    where it is not installed.
    """
    package = Path(__file__).resolve().parent
    for root in (package / "data", package.parent):
        if (root / name).exists():
            return root / name
    raise SaltusError(f"'{name}' is missing from this installation: reinstall saltus")
