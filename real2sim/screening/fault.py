"""What is wrong with a run log."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Something in a log that contradicts the log's own claims."""

    name: str
    """What kind, e.g. "swapped_joints"."""
    text: str
    """One sentence, with numbers and with what to do."""
    is_fatal: bool = True
    """Whether fitting to this log makes no sense."""
