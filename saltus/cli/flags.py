"""Kinds of flags that several commands have."""

from typing import Annotated, Any

import tyro

Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]
"""A flag that is off unless it is given; it has no opposite."""


def shown(metavar: str, default: str) -> Any:
    """How the help shows a flag that is None where it is not given.

    Args:
        metavar: What is to be given, e.g. PATH.
        default: What holds without it.
    """
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=f"(default: {default})")
