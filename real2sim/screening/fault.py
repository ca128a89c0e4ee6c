"""A fault of a run log."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Something in a log that contradicts its claims or itself."""

    name: str
    """Kind of fault, e.g. "swapped_joints"."""
    text: str
    """One sentence with numbers and the likely cause."""
    is_fatal: bool = True
    """True where the log cannot be fitted."""
