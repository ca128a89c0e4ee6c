"""The order of effects in a chain."""

from typing import Any

from saltus.effects.effect import Effect
from saltus.errors import ConfigError


def ordered(effects: tuple[Effect[Any], ...], order: tuple[str, ...], what: str) -> tuple[Effect[Any], ...]:
    """Sorts effects as `order` names them and leaves out those that are null.

    Raises:
        ConfigError: an effect that is given twice or not in `order`; `what` says of what, e.g. "a camera".
    """
    names = [effect.name for effect in effects]
    for name in names:
        if name not in order:
            raise ConfigError(f"'{name}' is no effect of {what}: those are {', '.join(order)}")
        if names.count(name) > 1:
            raise ConfigError(f"'{name}' is given {names.count(name)} times: {what} has each effect once")
    return tuple(sorted((e for e in effects if not e.is_null()), key=lambda e: order.index(e.name)))
