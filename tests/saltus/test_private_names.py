"""Libraries are used by the names that they offer:
what begins with an underscore may go with their next version.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROOMS = (
    "saltus",
    "heightmap",
    "render",
    "policy",
    "controller",
    "real2sim",
    "paper",
    "benchmarks",
    "examples",
    "tools",
)
OURS = {*ROOMS, "__future__"}
PRIVATE = re.compile(r"_(?!_).*|__(?!.*__$).*")
MANGLED = re.compile(r"_[A-Z]\w*__\w+")
"""Python's name of a private attribute of a class, e.g. in `setattr`."""
OFFERED = {"os._exit", "torch._dynamo", "torch._inductor"}
"""Documented by Python, and by PyTorch for compilers of one's own and for limits of compilation."""
MAY_BE_USED = {"_replace", "_asdict", "_fields"} | {name.rpartition(".")[2] for name in OFFERED}
"""The first three are offered by named tuples."""
KINDS = (
    ast.Import, ast.ImportFrom, ast.Attribute, ast.Constant, ast.Call, ast.Name,
    ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef,
)  # fmt: skip
ATTRIBUTES = {"getattr", "setattr", "hasattr", "delattr"}


def private_names(nodes: list[ast.AST], own: set[str]) -> Iterator[tuple[int, str]]:
    """Lines of a file, and what private name of a library they use;
    `own` are all names that we give to anything.
    """
    libraries: set[str] = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            names = [
                (alias.name, alias.asname or alias.name.partition(".")[0]) for alias in node.names
            ]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names = [
                (f"{node.module}.{alias.name}", alias.asname or alias.name) for alias in node.names
            ]
        else:
            continue
        for name, bound in names:
            if name.partition(".")[0] not in OURS:
                libraries.add(bound)
                if not offered(name) and any(PRIVATE.fullmatch(part) for part in name.split(".")):
                    yield node.lineno, name
    for node in nodes:
        if isinstance(node, ast.Attribute) and PRIVATE.fullmatch(node.attr):
            is_of_library = root(node) in libraries and not offered(ast.unparse(node))
            if is_of_library or not (node.attr in own or node.attr in MAY_BE_USED):
                yield node.lineno, ast.unparse(node)
        elif (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and MANGLED.fullmatch(node.value)
        ):
            yield node.lineno, node.value
        elif (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name)
            and node.func.id in ATTRIBUTES
        ):
            named = [a.value for a in node.args[1:2] if isinstance(a, ast.Constant)]
            yield from (
                (node.lineno, name) for name in named if PRIVATE.fullmatch(name) and name not in own
            )


def nodes_of(source: str) -> list[ast.AST]:
    """The nodes that may use a name, or give one."""
    return [node for node in ast.walk(ast.parse(source)) if isinstance(node, KINDS)]


def offered(name: str) -> bool:
    return any(name == known or name.startswith(f"{known}.") for known in OFFERED)


def root(node: ast.AST) -> str:
    """The variable with which an expression begins, e.g. of `mcap.Writer(file)._index`."""
    while not isinstance(node, ast.Name):
        inner = getattr(node, "value", getattr(node, "func", None))
        if inner is None or isinstance(node, ast.Constant):
            return ""
        node = inner
    return node.id


def given_names(nodes: list[ast.AST]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.id if isinstance(node, ast.Name) else node.attr


def test_no_private_name_of_a_library_is_used() -> None:
    files = [
        path
        for room in ROOMS
        for path in (ROOT / room).rglob("*.py")
        if not any(map(Path.is_symlink, path.parents))
    ]
    sources = {path: nodes_of(path.read_text(encoding="utf-8")) for path in files}
    own = {name for nodes in sources.values() for name in given_names(nodes)}
    found = [
        f"{path.relative_to(ROOT)}:{line} {name}"
        for path, nodes in sources.items()
        for line, name in private_names(nodes, own)
    ]
    assert not found


@pytest.mark.parametrize(
    "source",
    [
        "from mcap._chunk_builder import ChunkBuilder",
        "import mcap.writer as w\nw._index",
        "from mcap.writer import Writer\nWriter(file)._index",
        "writer._index",
        "setattr(writer, '_index', [])",
        "NAME = '_Writer__chunk_indices'",
        "from torch import _C",
    ],
)
def test_reaches_into_a_library_are_seen(source: str) -> None:
    assert list(private_names(nodes_of(source), {"_own"}))


@pytest.mark.parametrize(
    "source", ["self._own", "state._replace(x=1)", "import os\nos._exit(1)", "a.__class__"]
)
def test_names_that_are_ours_or_offered_may_be_used(source: str) -> None:
    assert not list(private_names(nodes_of(source), {"_own"}))
