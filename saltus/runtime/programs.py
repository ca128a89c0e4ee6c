"""THE table of processes."""

from dataclasses import dataclass, replace


@dataclass(frozen=True, kw_only=True)
class Program:
    """A program of the stack: one row of the process table."""

    name: str
    module: str
    restart: bool
    """In real time: whether it is started again when it dies.

    Otherwise its end is the end of the run.
    """
    spare: bool = False
    """In real time: whether another process has loaded already, to take over when it dies."""
    hot: bool = False
    """In real time: whether what waits works along unheard.

    Its state must follow from what it hears.
    """
    arguments: tuple[str, ...] = ()
    """Arguments of this process, beside those of every process."""


PROGRAMS = (
    # Open3D alone takes half a second of a free processor, and several on a busy machine
    Program(name="render", module="saltus.render", restart=True, spare=True),
    Program(name="heightmap", module="saltus.heightmap", restart=True, hot=True),
    Program(name="policy", module="saltus.policy", restart=True, hot=True),
    # Holds the robot: the run begins when it begins, so it is started last, and ends when it ends
    Program(name="controller", module="saltus.controller", restart=False),
)

OPERATOR = Program(name="operator", module="saltus.drive", restart=True)
"""Gives the commands of a run that has a script of them."""


def scan_program(grid: str) -> Program:
    """The heights of a grid beside those that the planner is given; nobody waits for them."""
    return Program(
        name="scan", module="saltus.heightmap", restart=True, arguments=("--beside", "--grid", grid)
    )


WITH_STANDBYS = tuple(
    replace(program, spare=program.restart, hot=program.restart) for program in PROGRAMS
)
"""The processes, with a second camera, service and planner that work along unheard.

A robot among stepping stones, which cannot land well, can then go on; but on two cores ages have a
p99 of 30 to 58 ms instead of 10."""
