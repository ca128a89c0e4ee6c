"""Arrays whose entries are not numbers but notes of how they come about:
what laws on the array API make of them.

Constants are folded, and what is asked twice is one symbol. `saltus.straight_line` writes symbols
down as Python.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any, Union

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

Entry = Union["Symbol", float, bool]

FUNCTIONS = ("sin", "cos", "asin", "acos", "atan", "atan2", "sqrt", "exp", "floor", "round")
"""Functions of the standard that symbols have, by the names that they have in `math`, or in
Python."""
_ROUND: dict[str, Callable[..., float]] = {"floor": math.floor, "round": round}


class Symbol:
    """One entry of an array that is known by its making only: an operation on other entries."""

    __slots__ = ("arguments", "number", "operation")

    def __init__(self, operation: str, arguments: tuple[Any, ...], number: int) -> None:
        self.operation, self.arguments, self.number = operation, arguments, number


_notes: dict[tuple[object, ...], Symbol] = {}


def begin_law() -> None:
    """Begins a new law: symbols of one are not those of another."""
    _notes.clear()


def note_operation(operation: str, *arguments: object) -> Symbol:
    """The symbol of an operation on entries; it comes after all that were noted before."""
    key = (operation, *(a.number if isinstance(a, Symbol) else ("constant", a) for a in arguments))
    found = _notes.get(key)
    if found is None:
        found = _notes[key] = Symbol(operation, arguments, len(_notes))
    return found


def _add(a: Entry, b: Entry) -> Entry:
    if not isinstance(a, Symbol) and not isinstance(b, Symbol):
        return a + b
    if not isinstance(a, Symbol):
        a, b = b, a
    if not isinstance(b, Symbol):
        return a if b == 0.0 else note_operation("add", a, b)
    return note_operation("add", a, b)


def _subtract(a: Entry, b: Entry) -> Entry:
    if not isinstance(b, Symbol):
        return _add(a, -b)
    if not isinstance(a, Symbol) and a == 0.0:
        return _negative(b)
    return note_operation("subtract", a, b)


def _multiply(a: Entry, b: Entry) -> Entry:
    if not isinstance(a, Symbol) and not isinstance(b, Symbol):
        return a * b
    if not isinstance(a, Symbol):
        a, b = b, a
    if not isinstance(a, Symbol) or not isinstance(b, Symbol):
        if b in (1.0, -1.0):
            return a if b == 1.0 else _negative(a)
        return 0.0 if b == 0.0 else note_operation("multiply", a, b)
    return (
        note_operation("multiply", a, b)
        if a.number < b.number
        else note_operation("multiply", b, a)
    )


def _divide(a: Entry, b: Entry) -> Entry:
    if not isinstance(a, Symbol) and not isinstance(b, Symbol):
        return a / b
    if not isinstance(a, Symbol) and a == 0.0:
        return 0.0
    return note_operation("divide", a, b)


def _negative(a: Entry) -> Entry:
    if not isinstance(a, Symbol):
        return -a
    return a.arguments[0] if a.operation == "negative" else note_operation("negative", a)


def _less(a: Entry, b: Entry) -> Entry:
    return (
        note_operation("less", a, b)
        if isinstance(a, Symbol) or isinstance(b, Symbol)
        else bool(a < b)
    )


def _less_equal(a: Entry, b: Entry) -> Entry:
    return (
        note_operation("less_equal", a, b)
        if isinstance(a, Symbol) or isinstance(b, Symbol)
        else bool(a <= b)
    )


def _and(a: Entry, b: Entry) -> Entry:
    for one, other in ((a, b), (b, a)):
        if not isinstance(one, Symbol):
            return other if one else False
    return a if a is b else note_operation("and", a, b)


def _or(a: Entry, b: Entry) -> Entry:
    for one, other in ((a, b), (b, a)):
        if not isinstance(one, Symbol):
            return True if one else other
    return a if a is b else note_operation("or", a, b)


def _not(a: Entry) -> Entry:
    return note_operation("not", a) if isinstance(a, Symbol) else not a


def _minimum(a: Entry, b: Entry) -> Entry:
    for one, other in ((a, b), (b, a)):
        if not isinstance(one, Symbol) and one == math.inf:
            return other
    return (
        note_operation("minimum", a, b)
        if isinstance(a, Symbol) or isinstance(b, Symbol)
        else min(a, b)
    )


def _maximum(a: Entry, b: Entry) -> Entry:
    for one, other in ((a, b), (b, a)):
        if not isinstance(one, Symbol) and one == -math.inf:
            return other
    return (
        note_operation("maximum", a, b)
        if isinstance(a, Symbol) or isinstance(b, Symbol)
        else max(a, b)
    )


def _where(condition: Entry, a: Entry, b: Entry) -> Entry:
    if not isinstance(condition, Symbol):
        return a if condition else b
    if a is b or (not isinstance(a, Symbol) and not isinstance(b, Symbol) and a == b):
        return a
    return note_operation("where", condition, a, b)


def _function(name: str) -> Callable[..., "Symbols"]:
    def noted(*arguments: Entry) -> Entry:
        if any(isinstance(a, Symbol) for a in arguments):
            return note_operation(name, *arguments)
        return float(known(*arguments))

    known: Callable[..., float] = _ROUND.get(name) or getattr(math, name)
    made = np.frompyfunc(noted, 2 if name == "atan2" else 1, 1)
    return lambda *arrays: _apply(made, *arrays)


_ADD, _SUBTRACT, _MULTIPLY, _DIVIDE = (
    np.frompyfunc(f, 2, 1) for f in (_add, _subtract, _multiply, _divide)
)
_LESS, _LESS_EQUAL, _AND, _OR = (np.frompyfunc(f, 2, 1) for f in (_less, _less_equal, _and, _or))
_MINIMUM, _MAXIMUM = np.frompyfunc(_minimum, 2, 1), np.frompyfunc(_maximum, 2, 1)
_NEGATIVE, _NOT, _WHERE = (
    np.frompyfunc(_negative, 1, 1),
    np.frompyfunc(_not, 1, 1),
    np.frompyfunc(_where, 3, 1),
)


class Symbols(NDArrayOperatorsMixin):
    """An array of symbols and constants: as much of the array API as laws use,
    whose names its methods have.
    """

    # ruff: noqa: D102 - see the standard
    dtype, device = "symbols", "cpu"

    def __init__(self, entries: object) -> None:
        self.entries: NDArray[np.object_] = np.asarray(entries, dtype=object)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *arguments: object) -> Any:
        operation = _OPERATORS.get(ufunc) if method == "__call__" else None
        return NotImplemented if operation is None else operation(*arguments)

    def __array_namespace__(self, api_version: str | None = None) -> object:
        return _NAMESPACE

    @property
    def shape(self) -> tuple[int, ...]:
        return self.entries.shape

    @property
    def ndim(self) -> int:
        return self.entries.ndim

    @property
    def mT(self) -> "Symbols":  # noqa: N802 - the standard's name
        return Symbols(np.swapaxes(self.entries, -1, -2))

    def reshape(self, shape: tuple[int, ...]) -> "Symbols":
        return Symbols(self.entries.reshape(shape))

    def __getitem__(self, place: Any) -> "Symbols":
        return Symbols(self.entries[place])


def _entries(value: object) -> NDArray[np.object_]:
    return value.entries if isinstance(value, Symbols) else np.asarray(value).astype(object)


def _apply(function: np.ufunc, *arguments: object) -> Symbols:
    return Symbols(function(*map(_entries, arguments)))


def _product(left: object, right: object) -> Symbols:
    a, b = _entries(left), _entries(right)
    if a.ndim == 1:
        return _product(Symbols(a[None, :]), Symbols(b))[..., 0, :]
    return _sum(Symbols(_MULTIPLY(a[..., :, :, None], b[..., None, :, :])), axis=-2)


def _sum(array: Symbols, axis: int, keepdims: bool = False) -> Symbols:
    return Symbols(_ADD.reduce(array.entries, axis=axis, keepdims=keepdims))


def _clip(array: Symbols, low: object = None, high: object = None) -> Symbols:
    array = array if low is None else _apply(_MAXIMUM, array, low)
    return array if high is None else _apply(_MINIMUM, array, high)


def _power(array: Symbols, power: object) -> Symbols:
    if power != 2:
        raise TypeError(f"symbols can be squared, not raised to {power}")
    return array * array


_OPERATORS: dict[np.ufunc, Callable[..., Symbols]] = {
    np.add: partial(_apply, _ADD),
    np.subtract: partial(_apply, _SUBTRACT),
    np.multiply: partial(_apply, _MULTIPLY),
    np.true_divide: partial(_apply, _DIVIDE),
    np.negative: partial(_apply, _NEGATIVE),
    np.absolute: lambda array: _apply(_MAXIMUM, array, -array),
    np.power: _power,
    np.matmul: _product,
    np.less: partial(_apply, _LESS),
    np.less_equal: partial(_apply, _LESS_EQUAL),
    np.greater: lambda one, other: _apply(_LESS, other, one),
    np.greater_equal: lambda one, other: _apply(_LESS_EQUAL, other, one),
    np.bitwise_and: partial(_apply, _AND),
    np.bitwise_or: partial(_apply, _OR),
    np.invert: partial(_apply, _NOT),
}
"""Functions of symbols, by the operator of numpy that asks for each."""
_NAMESPACE = SimpleNamespace(
    __name__="symbols",
    **{name: _function(name) for name in FUNCTIONS},
    float32="symbols",
    asarray=lambda value, **_: Symbols(_entries(value)),
    astype=lambda array, _: array,
    zeros_like=lambda array: Symbols(np.full(array.shape, 0.0)),
    ones_like=lambda array: Symbols(np.full(array.shape, 1.0)),
    where=lambda condition, a, b: _apply(_WHERE, condition, a, b),
    minimum=lambda a, b: _apply(_MINIMUM, a, b),
    maximum=lambda a, b: _apply(_MAXIMUM, a, b),
    clip=_clip,
    abs=abs,
    sign=lambda array: _apply(_WHERE, array < 0.0, -1.0, _apply(_WHERE, array > 0.0, 1.0, 0.0)),
    sum=_sum,
    mean=lambda array, axis: _sum(array, axis) * (1.0 / array.shape[axis]),
    all=lambda array, axis: Symbols(_AND.reduce(array.entries, axis=axis)),
    stack=lambda arrays, axis=0: Symbols(np.stack([_entries(a) for a in arrays], axis=axis)),
    concat=lambda arrays, axis=0: Symbols(np.concatenate([_entries(a) for a in arrays], axis=axis)),
    broadcast_to=lambda array, shape: Symbols(np.broadcast_to(array.entries, shape)),
    reshape=lambda array, shape: array.reshape(shape),
)  # fmt: skip


def noted_call(function: Callable[..., Sequence[float]], arguments: Symbols, count: int) -> Symbols:
    """Symbols of the floats that a function returns which cannot be noted itself.

    Args:
        function: Takes the entries of `arguments`, one by one.
        arguments: Of any shape.
        count: Number of floats that it returns.
    """
    result = note_operation("call", function, *arguments.entries.reshape(-1))
    return Symbols([note_operation("item", result, index) for index in range(count)])
