"""Parameters of cameras that differ from robot to robot."""

from typing import Any

from saltus.effects.effect import PerRobot, like


def per_image(value: PerRobot, array: Any, xp: Any) -> Any:
    """A parameter in the form in which it combines with images: a float, or shape (..., 1, 1)."""
    found = like(value, array, xp)
    return found if isinstance(found, float | int) or found.ndim == 0 else found[..., None, None]
