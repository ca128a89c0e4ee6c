"""Errors that a user can act on."""

import difflib
from collections.abc import Iterable


class SaltusError(Exception):
    """Base of every error that Saltus raises on purpose. The CLI prints it as one line and exits with code 2."""


class ConfigError(SaltusError):
    """A configuration value or key that cannot be used."""


class MessageError(SaltusError):
    """A message that must be rejected. `reason` is a short code that rejections are counted under."""

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(f"{reason}: {detail}" if detail else reason)
        self.reason = reason


class RecordingError(SaltusError):
    """A recording that cannot be read or written."""


class ModelError(SaltusError):
    """A model file that is damaged or does not fit what it is used for."""


class StackError(SaltusError):
    """A process of the stack died or went silent."""


def nearest_hint(name: str, choices: Iterable[str]) -> str:
    """Says which of `choices` is closest to `name`, for use at the end of an error message."""
    known = sorted(choices)
    close = difflib.get_close_matches(name, known, n=1)
    if close:
        return f"did you mean '{close[0]}'?"
    return "choose one of: " + ", ".join(known)
