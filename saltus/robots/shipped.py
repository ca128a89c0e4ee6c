"""What Saltus ships of robots: folders of data beside this module."""

from pathlib import Path

from saltus.errors import ConfigError, nearest_hint

SUPPLEMENT_FILE = "robot.toml"
PROFILE_FILE = "profile.toml"
_HERE = Path(__file__).resolve().parent


def shipped_robots() -> list[str]:
    """Names of robots."""
    return sorted(file.parent.name for file in _HERE.glob(f"*/{SUPPLEMENT_FILE}"))


def shipped_folder(name: str) -> Path:
    """The folder of one of `shipped_robots`.

    Raises:
        ConfigError: it is none of them.
    """
    if name not in shipped_robots():
        raise ConfigError(f"no robot '{name}': {nearest_hint(name, shipped_robots())}")
    return _HERE / name


def shipped_profiles() -> dict[str, Path]:
    """Files of profiles that robots have as shipped, by the robots' names."""
    return {file.parent.name: file for file in sorted(_HERE.glob(f"*/{PROFILE_FILE}"))}
