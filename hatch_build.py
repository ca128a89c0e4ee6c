"""An editable installation reads rooms and models where they lie: it gets no copies of them."""

from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

MARK = "saltus/py.typed"
"""Hatchling takes all of a wheel's `force-include` where an editable one has none of its own."""


class Rooms(BuildHookInterface[Any]):
    """Leaves a wheel as pyproject.toml says."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Before a wheel is built: `version` is "standard" or "editable"."""
        if version == "editable":
            build_data["force_include_editable"][MARK] = MARK
