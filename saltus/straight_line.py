"""Laws on arrays, compiled for one robot: straight-line Python on floats, without an array.

A call on a small array costs ten times its arithmetic, and a law is hundreds of such calls.
`straight_line` runs the law once on arrays of symbols (`saltus.symbols`) and writes them down as
one function: what nobody asks for is left out, and what one branch of a `where` alone needs is
computed in that branch. The law on numpy stays the reference.
"""

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from typing import Any

import numpy as np

from saltus.symbols import FUNCTIONS, Entry, Symbol, Symbols, begin_law, note_operation

_LEAST_GUARDED = 8
"""Operations from which on a branch of its own is worth its test."""
_DEEPEST = 12
"""Operations in one expression; Python reads no more than 200 parentheses in each other."""
_TEXTS = {
    "add": "({} + {})", "subtract": "({} - {})", "multiply": "({} * {})", "divide": "({} / {})",
    "negative": "(-{})",
    "less": "({} < {})", "less_equal": "({} <= {})", "and": "({} and {})", "or": "({} or {})",
    "not": "(not {})",
    "minimum": "({0} if {0} < {1} else {1})", "maximum": "({0} if {0} > {1} else {1})",
    "where": "({1} if {0} else {2})", "item": "{}[{}]",
}  # fmt: skip
_TEXTS |= {name: f"{name}({{}})" for name in FUNCTIONS} | {"atan2": "atan2({}, {})"}
_TRUTHS = ("less", "less_equal", "and", "or", "not")
_TWICE = ("minimum", "maximum")
"""Operations whose text names an argument twice."""


def straight_line(law: Callable[..., object], *examples: object) -> Callable[..., Any]:
    """Compiles a law for one robot.

    Args:
        law: Takes arrays and dataclasses of arrays, and returns some, in tuples if it likes.
        examples: Its arguments: numpy arrays, whose values do not matter, in tuples and dataclasses
            whose other values stay.

    Returns:
        A function that takes and returns the same in numpy. Where floats have no result (division
        by zero, the sine of infinity), it raises `ArithmeticError` or `ValueError`.
    """
    begin_law()
    reader = _Reader()
    arguments = [reader.read(example, f"a{number}") for number, example in enumerate(examples)]
    result = _Result(reader.paths)
    returned = result.text(law(*arguments))
    writer = _Writer([*result.floats, *result.flags])
    made = [
        f"    {name} = array(({''.join(writer.text(e) + ', ' for e in entries)}), {kind})"
        for name, entries, kind in (
            ("floats", result.floats, "float"),
            ("flags", result.flags, "bool"),
        )
        if entries
    ]
    head = f"def law({', '.join(f'a{number}' for number in range(len(examples)))}):"
    text = "\n".join(
        [head, *reader.lines(writer), *writer.lines(), *made, f"    return {returned}"]
    )
    functions = (
        {name: getattr(math, name, round) for name in FUNCTIONS} | writer.functions | result.kinds
    )
    scope: dict[str, Any] = {**functions, "array": np.array, "inf": math.inf, "nan": math.nan}
    exec(compile(text, "<law>", "exec"), scope)  # noqa: S102 - a text of its own making
    compiled: Callable[..., Any] = scope["law"]
    return compiled


class _Reader:
    """Makes symbols of arguments, and the lines that read their entries."""

    def __init__(self) -> None:
        self.paths: dict[tuple[object, ...], str] = {}
        """Where an array is found, by its symbols."""
        self._read: list[tuple[str, tuple[int, ...], list[Symbol]]] = []

    def read(self, example: object, path: str) -> object:
        """A copy of an example whose arrays and floats are symbols; `path` is where it is found."""
        if isinstance(example, np.ndarray | float):
            shape = np.shape(example)
            stem = path.translate({ord("."): "_", ord("["): "_", ord("]"): None})
            names = [note_operation("input", f"{stem}_{i}") for i in range(math.prod(shape))]
            if not isinstance(example, float):  # which is to come back as numpy's
                self.paths[tuple(names)] = path
            self._read.append((path, shape, names))
            return Symbols(np.array(names, dtype=object).reshape(shape))
        if isinstance(example, tuple):
            return tuple(self.read(part, f"{path}[{i}]") for i, part in enumerate(example))
        if not is_dataclass(example):
            return example
        values = {
            f.name: self.read(getattr(example, f.name), f"{path}.{f.name}") for f in fields(example)
        }
        return replace(example, **values)  # type: ignore[type-var]

    def lines(self, writer: "_Writer") -> list[str]:
        """Assignments of all entries that anybody asks for."""
        return [
            f"    {''.join(symbol.arguments[0] + ', ' for symbol in symbols)} = "
            + (
                f"{path}{'.reshape(-1)' if len(shape) > 1 else ''}.tolist()"
                if shape
                else f"(float({path}),)"
            )
            for path, shape, symbols in self._read
            if any(map(writer.asks_for, symbols))
        ]


class _Result:
    """Writes down what a law returns: entries in two arrays,
    and the expression that makes arrays of them again.
    """

    def __init__(self, paths: dict[tuple[object, ...], str]) -> None:
        self.floats: list[Entry] = []
        self.flags: list[Entry] = []
        self.kinds: dict[str, type] = {}
        """Dataclasses by the names that they have in the expression."""
        self._paths = paths

    def text(self, value: object) -> str:
        """The expression."""
        if isinstance(value, Symbols):
            return self._array(value)
        if isinstance(value, tuple):
            return f"({''.join(self.text(part) + ', ' for part in value)})"
        kind = type(value)
        self.kinds[kind.__name__] = kind
        if not is_dataclass(value):
            return f"{kind.__name__}.{value.name}" if isinstance(value, Enum) else repr(value)
        named = (f"{each.name}={self.text(getattr(value, each.name))}" for each in fields(value))
        return f"{kind.__name__}({', '.join(named)})"

    def _array(self, array: Symbols) -> str:
        entries = array.entries.reshape(-1).tolist()
        if (path := self._paths.get(tuple(entries))) is not None:
            return path
        flags = all(
            isinstance(e, bool) or (isinstance(e, Symbol) and e.operation in _TRUTHS)
            for e in entries
        )
        name, known = ("flags", self.flags) if flags else ("floats", self.floats)
        start = len(known)
        known += entries
        if not array.shape:
            return f"{name}[{start}]"
        text = f"{name}[{start}:{start + len(entries)}]"
        return text if array.ndim == 1 else f"{text}.reshape({array.shape})"


Need = frozenset[tuple[Symbol, bool]]
_ALWAYS: Need = frozenset()


class _Writer:
    """Writes symbols down as lines of Python, each in the branch that alone needs it."""

    def __init__(self, outputs: list[Entry]) -> None:
        self.functions: dict[str, Callable[..., object]] = {}
        """Functions that the lines call, by name."""
        self._symbols = _reached(outputs)
        self._uses = Counter(a for s in self._symbols for a in s.arguments if isinstance(a, Symbol))
        self._uses.update(o for o in outputs if isinstance(o, Symbol))
        self._twice = {
            a
            for s in self._symbols
            if s.operation in _TWICE
            for a in s.arguments
            if isinstance(a, Symbol)
        }
        self._twice |= {s.arguments[0] for s in self._symbols if s.operation == "where"}
        self._needs = self._needed(outputs, self._guards(outputs))
        self._names: dict[Symbol, str] = {
            s: s.arguments[0] for s in self._symbols if s.operation == "input"
        }
        self._depths: dict[Symbol, int] = {}
        for symbol in self._symbols:
            self._name(symbol)

    def asks_for(self, symbol: Symbol) -> bool:
        """True where an output depends on it."""
        return symbol in self._needs

    def text(self, entry: Entry) -> str:
        """A symbol's name, or where it has none, its expression."""
        if not isinstance(entry, Symbol):
            return repr(float(entry)) if not isinstance(entry, bool) else repr(entry)
        return self._names.get(entry) or self._expression(entry)

    def lines(self) -> list[str]:
        """Assignments, in an order in which each comes after those that it reads."""
        waiting = defaultdict[Need, list[Symbol]](list)
        for symbol in self._symbols:
            if symbol in self._names and symbol.operation != "input":
                waiting[self._needs[symbol]].append(symbol)
        written, lines = {s for s in self._symbols if s.operation == "input"}, list[str]()
        while waiting:
            ready = {need: self._ready(group, need, written) for need, group in waiting.items()}
            need = min(
                ready, key=lambda need: (len(need) if ready[need] else math.inf, -len(ready[need]))
            )
            tests = sorted(
                (c.number, f"{'' if true else 'not '}{self._names[c]}") for c, true in need
            )
            lines += [f"    if {' and '.join(text for _, text in tests)}:"] if tests else []
            indent = "        " if tests else "    "
            lines += [f"{indent}{self._names[s]} = {self._expression(s)}" for s in ready[need]]
            written.update(ready[need])
            waiting[need] = [s for s in waiting[need] if s not in written]
            if not waiting[need]:
                del waiting[need]
        return lines

    def _ready(self, group: list[Symbol], need: Need, written: set[Symbol]) -> list[Symbol]:
        """Symbols of a group that can be written now, one after the other."""
        if not all(condition in written for condition, _ in need):
            return []
        ready, known = list[Symbol](), set(written)
        for symbol in group:
            if all(read in known for read in self._reads(symbol)):
                ready.append(symbol)
                known.add(symbol)
        return ready

    def _reads(self, symbol: Symbol) -> Iterable[Symbol]:
        """Named symbols in the expression of this one."""
        for argument in symbol.arguments:
            if isinstance(argument, Symbol):
                if argument in self._names:
                    yield argument
                else:
                    yield from self._reads(argument)

    def _expression(self, symbol: Symbol) -> str:
        operation, arguments = symbol.operation, symbol.arguments
        if operation == "call":
            name = f"f{symbol.number}"
            self.functions[name] = arguments[0]
            return f"{name}({', '.join(map(self.text, arguments[1:]))})"
        if operation == "item":
            return f"{self.text(arguments[0])}[{arguments[1]}]"
        return _TEXTS[operation].format(*map(self.text, arguments))

    def _name(self, symbol: Symbol) -> None:
        """Names what is read more than once, what must not be read lazily,
        and what would be too deep.
        """
        arguments = [a for a in symbol.arguments if isinstance(a, Symbol)]
        depth = 1 + max((self._depths[a] for a in arguments if a not in self._names), default=0)
        several = self._uses[symbol] > 1 or symbol in self._twice or symbol.operation == "call"
        if symbol not in self._names and (several or depth > _DEEPEST):
            self._names[symbol] = f"v{symbol.number}"
        self._depths[symbol] = depth

    def _guards(self, outputs: list[Entry]) -> set[Symbol]:
        """Conditions on which enough depends to test them."""
        every = {s.arguments[0] for s in self._symbols if s.operation == "where"}
        counts = Counter(
            condition for need in self._needed(outputs, every).values() for condition, _ in need
        )
        return {condition for condition in every if counts[condition] >= _LEAST_GUARDED}

    def _needed(self, outputs: list[Entry], guards: set[Symbol]) -> dict[Symbol, Need]:
        """Conditions, all of which hold where a symbol is asked for."""
        needs: dict[Symbol, Need] = {o: _ALWAYS for o in outputs if isinstance(o, Symbol)}
        for symbol in reversed(self._symbols):
            need = needs[symbol]
            branches = [need] * len(symbol.arguments)
            if symbol.operation == "where" and symbol.arguments[0] in guards:
                condition = symbol.arguments[0]
                branches[1:] = [need | {(condition, True)}, need | {(condition, False)}]
            for argument, branch in zip(symbol.arguments, branches, strict=True):
                if isinstance(argument, Symbol):
                    needs[argument] = needs.get(argument, branch) & branch
        return needs


def _reached(outputs: list[Entry]) -> list[Symbol]:
    """All symbols that outputs depend on, each after those that it depends on."""
    found: dict[int, Symbol] = {}
    left = [o for o in outputs if isinstance(o, Symbol)]
    while left:
        symbol = left.pop()
        if symbol.number not in found:
            found[symbol.number] = symbol
            left += [a for a in symbol.arguments if isinstance(a, Symbol)]
    return [found[number] for number in sorted(found)]
