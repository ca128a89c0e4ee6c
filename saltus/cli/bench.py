"""`saltus bench`: the measurements behind the numbers in the documentation."""

import runpy
import sys
from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from saltus.resources import resource


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Measures this machine; each benchmark prints its figures and ends with one JSON object on the last line."""

    what: Annotated[
        Literal[
            "qp",
            "render",
            "inference",
            "transport",
            "stack",
            "planner",
            "train",
            "stance_batched",
            "faults",
            "landing",
            "service_faults",
        ],
        tyro.conf.Positional,
    ]
    """qp: ground reaction forces and the leg controller. render: the depth cameras. inference: the heightmap service.
    transport: the bus. stack: a real-time run. planner: its success on fresh seeds. train: the
    motion policy's training. stance_batched: its stance solver against the exact one. faults: processes killed during
    a run. landing: robots at full speed that are left without a planner. service_faults: error of the heights after
    faults of the camera's stream."""
    arguments: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """Passed to the benchmark, one at a time."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """The last line is JSON with or without it; here for uniformity with the other commands."""

    def run(self) -> int:
        """Runs the benchmark's script in this process."""
        script = str(resource(f"benchmarks/{self.what}.py"))
        before = sys.argv
        sys.argv = [script, *self.arguments]
        try:
            runpy.run_path(script, run_name="__main__")
        finally:
            sys.argv = before
        return 0
