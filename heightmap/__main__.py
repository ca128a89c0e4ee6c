"""Entry point of the heightmap process: one robot,
that of run.toml, or those that --robots names.
"""

import argparse
import contextlib
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from saltus.errors import ConfigError
from saltus.heightmap.service.process import HeightmapProcess
from saltus.heightmap.service.scan_fleet import ROBOT_BODY, ScanChoice
from saltus.runtime.process import PEER_FLAG, ProcessContext, run_process
from saltus.wire.zenoh_bus import ZenohBus


def body(
    context: ProcessContext,
    robots: Sequence[str] = (),
    endpoint: str = "",
    *,
    peer: bool = False,
    scan: ScanChoice | None = None,
) -> None:
    """Serves `robots`, each on a bus of its own (`peer`: see `ZenohBus`);
    run.toml's robot where there are none.

    The grid is run.toml's where there is no `scan`.
    """
    own = context.config.prefix
    scan = scan or _scan_of_run(context)
    with contextlib.ExitStack() as buses:
        contexts = []
        for robot in dict.fromkeys(robots or [own]):
            if robot == own:
                contexts.append(context)
                continue
            config = replace(context.config, prefix=robot)
            bus = buses.enter_context(
                ZenohBus.of_run(endpoint, config, peer=peer, bell=context.bus.bell)
            )
            contexts.append(ProcessContext(context.name, config, context.run_dir, bus))
        process = HeightmapProcess(contexts, scan)
        for each in contexts:
            each.ready()
        process.run(lambda: context.stopped)


def _scan_of_run(context: ProcessContext) -> ScanChoice | None:
    """Heights of a run that is of another grid than the line;
    None of the line, or of true heights.
    """
    if context.config.heights == "true":
        return None
    model = context.config.heightmap_model
    path = None if model is None else Path(model)
    return ScanChoice.of_flags(context.config.grid, None, (), ROBOT_BODY, path)


def _run(context: ProcessContext, own: argparse.Namespace) -> None:
    """Reads what the arguments name: where something is wrong with it, the process says so."""
    is_true = context.config.heights == "true" and not own.beside
    grid = own.grid or ("" if is_true else context.config.grid)
    scan = ScanChoice.of_flags(grid, own.dialect, own.cameras, own.body, own.model)
    if scan is None and own.model is not None:
        raise ConfigError("--model needs a grid: --grid scan; the line's network is run.toml's")
    if scan is not None:
        sys.stdout.write(f"heightmap: {scan.missing(context.setup.robot)}\n")
    body(context, own.robots, own.endpoint, peer=own.peer, scan=scan)


def main(arguments: Sequence[str] | None = None) -> int:
    """Reads what this process has beyond every process's arguments, and runs it."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--robots", nargs="+", default=[])
    parser.add_argument("--endpoint", default="")
    parser.add_argument(PEER_FLAG, action="store_true")
    parser.add_argument("--grid", default="")
    parser.add_argument("--dialect", default="")
    parser.add_argument("--cameras", nargs="+", default=[])
    parser.add_argument("--body", default=ROBOT_BODY)
    parser.add_argument("--model", type=Path)
    parser.add_argument("--beside", action="store_true")  # another process serves the planner
    own, others = parser.parse_known_args(arguments)
    run = partial(_run, own=own)
    shared = [
        *(["--endpoint", own.endpoint] if own.endpoint else []),
        *([PEER_FLAG] if own.peer else []),
    ]
    return run_process("scan" if own.beside else "heightmap", run, [*others, *shared])


if __name__ == "__main__":
    sys.exit(main())
