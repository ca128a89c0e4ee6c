"""How flags look in a help."""

from typing import Any

import tyro


def shown(metavar: str, default: str) -> Any:
    """For the annotation of a flag that is None by default: what it takes, and what holds without it."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=f"(default: {default})")
