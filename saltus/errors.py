"""Errors that a user can act on."""

import difflib
from collections.abc import Iterable

_SURE = 0.8
"""Similarity from which on a name is a misspelt other one, and not another word with a part of
it."""

_LISTED = 50
"""Names that one line lists: all effects, benchmarks or joints, and not the hundreds of columns of
a table."""


class SaltusError(Exception):
    """Base of every error that Saltus raises on purpose.

    The CLI prints it as one line and exits with code 2.
    """


class ConfigError(SaltusError):
    """A configuration value or key that cannot be used."""


class MessageError(SaltusError):
    """A message that must be rejected.

    `reason` is a short code that rejections are counted under.
    """

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
    """Says which of `choices` is closest to `name`, or the closest two,
    for use at the end of an error message.
    """
    known = sorted(choices)
    close = difflib.get_close_matches(name, known, n=2)
    if close:
        is_sure = difflib.SequenceMatcher(None, close[0], name).ratio() >= _SURE
        return f"did you mean {' or '.join(repr(each) for each in close[: 1 if is_sure else 2])}?"
    return f"choose one of: {shorten_names(known)}"


def check_known(
    what: str,
    name: str,
    choices: Iterable[str],
    *,
    within: str = "",
    error: type[SaltusError] = ConfigError,
) -> None:
    """Refuses a name that is none of `choices`: "no robot 'go3': did you mean ...".

    `within` is put before the name, as the tables of a file that it stands in: "gains.".

    Raises:
        SaltusError: of the kind `error`.
    """
    known = list(choices)
    if name not in known:
        raise error(f"{what} '{within}{name}': {nearest_hint(name, known)}")


def shorten_names(names: Iterable[str]) -> str:
    """Names in a message: the first of them and how many more there are."""
    known = list(names)
    more = len(known) - _LISTED
    return ", ".join(known) if more <= 1 else f"{', '.join(known[:_LISTED])} and {more} more"
