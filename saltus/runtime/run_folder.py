"""The folder of a run: what all who take part in it read."""

from dataclasses import dataclass
from pathlib import Path

from saltus import config
from saltus.config import RunConfig
from saltus.errors import ConfigError
from saltus.setup import Setup
from saltus.wire.joining import read_client

RUN_FILE = "run.toml"
SETUP_FILE = "setup.toml"
"""The values that run.toml names, whole: no process needs to derive the robot or to make the
terrain."""
CLIENT_FILE = "client.json5"
"""The configuration of Zenoh with which any program joins the run."""


@dataclass(frozen=True, kw_only=True)
class RunFolder:
    """The files of a run's folder, read: its configuration and setup."""

    config: RunConfig
    setup: Setup


def write_run(run_dir: Path, run_config: RunConfig, setup: Setup) -> None:
    """Writes the files of a run that is about to begin."""
    (run_dir / RUN_FILE).write_text(config.to_toml(run_config), encoding="utf-8")
    (run_dir / SETUP_FILE).write_text(setup.to_toml(), encoding="utf-8")


def read_run(run_dir: Path) -> RunFolder:
    """Reads configuration and setup of the run in a folder.

    Raises:
        ConfigError: one cannot be read.
    """
    return RunFolder(
        config=read_config(run_dir), setup=config.load_config(Setup, run_dir / SETUP_FILE)
    )


def read_config(run_dir: Path) -> RunConfig:
    """Reads what the run is.

    Raises:
        ConfigError: it cannot be read, as in a folder of no run.
    """
    path = run_dir / RUN_FILE
    if not path.is_file():
        raise ConfigError(
            f"there is no {path}, so '{run_dir}' is no folder of a run: name that of a saltus up, "
            "demo or router, or "
            f"start one, e.g. saltus router --out {run_dir}"
        )
    return config.load_config(RunConfig, path)


def endpoint_of(run_dir: Path) -> str:
    """Path of the configuration with which a process joins the run's router;
    `StackError` where the folder does not name one.
    """
    read_client(run_dir / CLIENT_FILE)
    return str(run_dir / CLIENT_FILE)
