"""Entry point of the heightmap process: one robot, that of run.toml, or those that --robots names."""

import argparse
import contextlib
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from saltus.heightmap.service.process import HeightmapProcess
from saltus.runtime.process import PEER_FLAG, ProcessContext, run_process
from saltus.wire.zenoh_bus import ZenohBus


def body(context: ProcessContext, robots: Sequence[str], endpoint: str, *, peer: bool) -> None:
    """Serves `robots`, each on a bus of its own (`peer`: see `ZenohBus`); run.toml's robot where there are none."""
    own = context.config.prefix
    with contextlib.ExitStack() as buses:
        contexts = []
        for robot in dict.fromkeys(robots or [own]):
            if robot == own:
                contexts.append(context)
                continue
            config = replace(context.config, prefix=robot)
            bus = buses.enter_context(ZenohBus.of_run(endpoint, config, peer=peer, bell=context.bus.bell))
            contexts.append(ProcessContext(context.name, config, context.run_dir, bus))
        process = HeightmapProcess(contexts)
        for each in contexts:
            each.ready()
        process.run(lambda: context.stopped)


def main(arguments: Sequence[str] | None = None) -> int:
    """Reads what this process has beyond every process's arguments, and runs it."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--robots", nargs="+", default=[])
    parser.add_argument("--endpoint", default="")
    parser.add_argument(PEER_FLAG, action="store_true")
    own, others = parser.parse_known_args(arguments)
    run = partial(body, robots=own.robots, endpoint=own.endpoint, peer=own.peer)
    shared = [*(["--endpoint", own.endpoint] if own.endpoint else []), *([PEER_FLAG] if own.peer else [])]
    return run_process("heightmap", run, [*others, *shared])


if __name__ == "__main__":
    sys.exit(main())
