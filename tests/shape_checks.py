"""Checks the shapes that annotations state, at each call of the kernel's laws:
`pytest -p shape_checks`.

jaxtyping gives the shapes; a call is checked by it where an argument or a result is an array of a
stated shape.
"""

import functools
import inspect
import types
import typing
from collections.abc import Callable
from typing import Any

import jaxtyping

LAWS = [
    "saltus.rotations", "saltus.grid", "saltus.dialects", "saltus.plan", "saltus.states",
    "saltus.joint_command",
    "saltus.robots", "saltus.terrain", "saltus.effects", "saltus.controller",
]  # fmt: skip
jaxtyping.install_import_hook(LAWS, "shape_checks.checked")


def checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, which refuses arrays of other shapes than it states: `TypeError`."""
    signature = inspect.signature(function)
    stated = {
        name: each.annotation
        for name, each in signature.parameters.items()
        if is_shape(each.annotation)
    }
    result = signature.return_annotation

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        given = signature.bind(*args, **kwargs).arguments
        for name in stated.keys() & given.keys():
            refuse(function, name, given[name], stated[name])
        answer = function(*args, **kwargs)
        if is_shape(result):
            refuse(function, "its result", answer, result)
        return answer

    return call if stated or is_shape(result) else function


def refuse(function: Callable[..., Any], name: str, value: Any, annotation: Any) -> None:
    """Raises a `TypeError` for a value of another shape."""
    if not fits(value, annotation):
        shape = getattr(value, "shape", type(value).__name__)
        raise TypeError(
            f"{function.__module__}.{function.__qualname__}: {name}, {shape}, is no {annotation}"
        )


def is_shape(annotation: Any) -> bool:
    """True where an annotation states the shape of an array, or of one in a tuple."""
    is_array = isinstance(annotation, type) and issubclass(annotation, jaxtyping.AbstractArray)
    return is_array or any(map(is_shape, typing.get_args(annotation)))


def fits(value: Any, annotation: Any) -> bool:
    """True where the arrays in a value have the shapes of an annotation."""
    origin, parts = typing.get_origin(annotation), typing.get_args(annotation)
    if origin in (typing.Union, types.UnionType):
        return any(fits(value, part) for part in parts)
    if origin is tuple and isinstance(value, tuple):
        parts = parts[:1] * len(value) if parts[1:] == (...,) else parts
        return len(parts) == len(value) and all(map(fits, value, parts))
    is_class = isinstance(annotation, type) and origin is None and annotation is not Any
    return isinstance(value, annotation) if is_class else True
