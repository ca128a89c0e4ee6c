"""A robot's loop is written once, in saltus/loop;
who else steps an engine is listed here, with the reason.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("saltus", "heightmap", "render", "policy", "controller", "real2sim", "paper", "benchmarks")
ENGINES = {
    "DrivenRobots", "Plant", "BatchPlant", "Engine", "CpuEngine", "WarpEngine", "FreeRobots",
    "MujocoBatch",
}  # fmt: skip
"""Classes of saltus/sim whose `step` is one of the physics."""
OTHERS = {
    # a robot behind the interface of real ones: no law in it; lockstep/test_process_replay.py holds
    # the loop that commands it to Body
    "controller/robot/mujoco.py: MujocoRobot.write",
    # the robot's side of a DDS link: no law in it, commands come over the wire
    "controller/robot/unitree/simulated.py: SimulatedUnitree.step",
    # a loop beside saltus/loop, of both trainings: its stages change tensors in place, for CUDA graphs
    "policy/env/training_env.py: TrainingEnv.step",
    # commands or torques are played open-loop: no law, no estimator, no plan
    "real2sim/experiments/run.py: _move",
    "real2sim/problem/body/replay.py: BodyReplay._run",
}
"""Functions that step an engine outside of saltus/sim and saltus/loop."""


def steppers(tree: ast.Module, makers: frozenset[str] = frozenset()) -> Iterator[str]:
    """Names of functions that call `step` of what is bound to an engine in the same file.

    A name or attribute is bound to one where it is annotated with its class, or assigned what such
    a class or one of `makers`, functions that return one, makes.
    """
    makers = makers | ENGINES | set(returning(tree))
    bound = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.arg | ast.AnnAssign) and named(node.annotation) & ENGINES:
            bound.add(node.arg if isinstance(node, ast.arg) else last(node.target))
    for target, value in assigned(tree):
        if isinstance(value, ast.Call) and last(value.func) in makers:
            bound.add(last(target))
    bound.discard("")  # what is kept under a key has no name
    for target, value in assigned(tree):  # one name for another, e.g. self._plant = plant
        if last(value) in bound:
            bound.add(last(target))
    yield from calling(tree, bound, "")


def assigned(tree: ast.Module) -> Iterator[tuple[ast.expr, ast.expr]]:
    """Targets and values of assignments, one by one."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Assign):
            continue
        for target in node.targets:
            if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                yield from zip(target.elts, node.value.elts, strict=False)
            else:
                yield target, node.value


def calling(node: ast.AST, bound: set[str], inside: str) -> Iterator[str]:
    """Qualified names of functions with a call of `step` of one of some names."""
    for child in ast.iter_child_nodes(node):
        name = inside
        if isinstance(child, ast.FunctionDef | ast.ClassDef):
            name = f"{inside}.{child.name}".lstrip(".")
        called = child.func if isinstance(child, ast.Call) else None
        if (
            isinstance(called, ast.Attribute)
            and called.attr == "step"
            and last(called.value) in bound
        ):
            yield inside
        yield from calling(child, bound, name)


def returning(tree: ast.Module) -> Iterator[str]:
    """Functions that say they return an engine."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and named(node.returns) & ENGINES:
            yield node.name


def named(annotation: ast.expr | None) -> set[str]:
    """Names in an annotation, also in one that is a string."""
    if annotation is None:
        return set()
    if isinstance(annotation, ast.Constant) and isinstance(annotation.value, str):
        annotation = ast.parse(annotation.value, mode="eval").body
    return {last(node) for node in ast.walk(annotation)}


def last(node: ast.AST) -> str:
    """The last part of a dotted name; empty for what is none."""
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else ""


def trees() -> Iterator[tuple[str, ast.Module]]:
    """Files of the product and of what lies beside it, but for the engines' and the loop's own."""
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            text = path.read_text(encoding="utf-8")
            if ".step(" in text and not name.startswith(("saltus/sim/", "saltus/loop/")):
                yield name, ast.parse(text)


def test_nobody_else_steps_an_engine() -> None:
    known, makers = dict(trees()), frozenset({"make_engine"})  # of saltus.policy.training.train
    found = {f"{name}: {who}" for name, tree in known.items() for who in steppers(tree, makers)}
    assert found == OTHERS


@pytest.mark.parametrize(
    "text",
    [
        "def f(plant: Plant):\n    plant.step(0)",
        "def f(robots: 'BatchPlant | None'):\n    for _ in 'ab':\n        robots.step(0)",
        "def f():\n    engine = WarpEngine()\n    engine.step()",
        "def make() -> CpuEngine: ...\ndef f():\n    x = make()\n    x.step()",
        "class A:\n    def __init__(self, e: Engine):\n        self._e = e\n    def f(self):\n     "
        "   self._e.step()",
        "def f(plant: Plant):\n    one, two = plant, 0\n    one.step(0)",
        "def f(p: Plant):\n    q = p\n    return [q.step(c) for c in 'ab']",
    ],
)
def test_a_new_one_would_be_found(text: str) -> None:
    assert [name.rpartition(".")[2] for name in steppers(ast.parse(text))] == ["f"]


@pytest.mark.parametrize(
    "text", ["def f(law: Law):\n    law.step(0)", "def f(plant: Plant):\n    plant.reset()"]
)
def test_steps_of_others_are_none(text: str) -> None:
    assert not list(steppers(ast.parse(text)))
