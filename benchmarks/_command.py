"""Benchmarks: each is a dataclass whose fields are its flags, and which measures."""

import sys
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

import tyro
from tqdm import tqdm

from saltus.errors import ConfigError

Item = TypeVar("Item")


@dataclass(frozen=True, kw_only=True)
class Command(ABC):
    """Flags of all benchmarks.

    A file here that does not begin with "_" has one of these, called `Benchmark`.
    """

    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print the figures as one JSON object on the last line."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if number and name != "seed" and not value > 0:
                raise ConfigError(f"{name} = {value}: it must be more than 0")

    @abstractmethod
    def measure(self) -> dict[str, Any]:
        """Measures, and returns the figures as `saltus bench` prints them: as text, or as JSON."""


def progress(items: Iterable[Item], name: str = "", total: int | None = None) -> Iterable[Item]:
    """The items, with a bar on stderr that shows how many are done, where that is a terminal.

    `total` is how many there are, where they do not say so.
    """
    return tqdm(items, name, total, disable=None)


def tell(line: str) -> None:
    """Says on stderr what was found on the way."""
    tqdm.write(line, file=sys.stderr)
