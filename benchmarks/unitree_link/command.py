"""Round trips of a Go2's low level against a peer in C,
or logs of a simulated one with hidden effects.

Round trips: of our backend, and of a program in C, each with the same peer in C.

The peer answers each command whose checksum is right by a state that repeats it. It and the rival
are built with Debian's idlc and C library of Cyclone DDS 0.10.2, which Unitree ships. A round trip
holds packing, checksum, both ways over the loopback interface, unpacking and checks. Rival and ours
take turns, 500 commands a second each.

    saltus bench unitree_link
    saltus bench unitree_link -- --seconds 600 --rounds 1

Logs (`benchmarks.unitree_link.logs`): each of a robot with one hidden effect, which `find` is to
name. They go on where they were left when --out names a folder that was begun before.

    saltus bench unitree_link -- --measures logs --out runs/go2_logs

Preflights and faults (`benchmarks.unitree_link.planted`): healthy robots and planted faults, over no
network.

    saltus bench unitree_link -- --measures preflight --seeds 20 --planted 5
    saltus bench unitree_link -- --measures faults --seeds 20
"""

import json
import os
import subprocess
import tempfile
import time
from collections import Counter
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmarks._command import Command, progress, tell
from benchmarks.unitree_link.logs import HIDDEN, found
from benchmarks.unitree_link.planted import preflights, runs
from saltus.arrays import Floats
from saltus.constants import PHYSICS_DT
from saltus.controller.robot.unitree.link import COMMANDS, STATES, UnitreeLink
from saltus.controller.robot.unitree.robot import UnitreeRobot
from saltus.joint_command import JointCommand
from saltus.robots.loading import load_robot
from saltus.runtime.ticker import Ticker

HERE = Path(__file__).parent
LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo'/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<Peers><Peer address='localhost'/></Peers></Discovery></Domain></CycloneDDS>"
)
"""Settings of Cyclone for the programs in C."""
END_S = 60.0


def own_domain() -> int:
    """A DDS domain by the number of this process,
    so that others beside it are in others: 2 to 231.
    """
    return 2 + os.getpid() % 230


def compiled(folder: Path, name: str) -> Path:
    """A program in C, with types that Debian's idlc 0.10.2 makes."""
    subprocess.run(["/usr/bin/idlc", str(HERE / "unitree_go.idl")], cwd=folder, check=True)
    sources = [str(HERE / f"{name}.c"), "unitree_go.c"]
    command = ["/usr/bin/gcc", "-O1", "-I.", "-o", name, *sources, "-lddsc"]
    subprocess.run(command, cwd=folder, check=True)
    return folder / name


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    """How long a round trip takes, ours and that of a program in C, and whether any is lost.

    The peer ends by 0, or by 3 where a command was lost on the way: nobody repeats them.
    """

    measures: Literal["round_trips", "logs", "preflight", "faults"] = "round_trips"
    seeds: int = 20
    """Number of healthy robots in preflights, or of runs with each kind of fault."""
    planted: int = 5
    """Number of preflights with each kind of fault."""
    logs: int = len(HIDDEN)
    """Number of logs."""
    first_seed: int = 580
    """Seed of what is hidden."""
    out: Path = Path("runs/unitree_logs")
    """Folder that keeps logs and what was found."""
    seconds: float = 5.0
    """Length of each turn [s]."""
    rounds: int = 4
    """Number of turns of each of the two."""

    def measure(self) -> dict[str, Any]:
        """Round trips [ms], p50, p99 and the longest,
        and the ratio of the two p99; or what was found.
        """
        if self.measures == "preflight":
            return preflights(self.seeds, self.planted)
        if self.measures == "faults":
            return {"runs": runs(self.seeds)}
        return self._found() if self.measures == "logs" else self._round_trips()

    def _found(self) -> dict[str, Any]:
        rows = []
        for number in progress(range(self.logs)):
            done = self.out / f"{self.first_seed}_{number:02d}.json"
            if not done.exists():
                row = found(number, self.first_seed, self.out, own_domain())
                done.write_text(json.dumps(row), encoding="utf-8")
                tell(json.dumps(row))
            rows.append(json.loads(done.read_text(encoding="utf-8")))
        return {"found": dict(Counter(row["outcome"] for row in rows)), "logs": rows}

    def _round_trips(self) -> dict[str, Any]:
        count = round(self.seconds / PHYSICS_DT)
        environment = os.environ | {"CYCLONEDDS_URI": LOOPBACK}
        domain = str(own_domain())
        theirs: list[Floats] = []
        ours: list[Floats] = []
        with tempfile.TemporaryDirectory() as name:
            peer, rival = (compiled(Path(name), each) for each in ("peer", "client"))
            # Each of our turns ends with one that damps; the peer does not wait for the last
            wanted = str(self.rounds * (2 * count + 1) - 1)
            with subprocess.Popen(
                [str(peer), domain, wanted],
                env=environment,
                stdout=subprocess.PIPE,
                encoding="utf-8",
            ) as other:
                for _ in progress(range(self.rounds)):
                    told = subprocess.run(
                        [str(rival), domain, str(count)], env=environment, check=True,
                        stdout=subprocess.PIPE, encoding="utf-8",
                    ).stdout  # fmt: skip
                    theirs.append(1e-3 * np.array(told.split(), dtype=np.float64))
                    ours.append(_our_turn(count))
                out, _ = other.communicate(timeout=END_S)
        answered, wrong = (int(word) for word in out.split()[2:])
        in_c, here = _figures(np.concatenate(theirs)), _figures(np.concatenate(ours))
        return {
            "in C": in_c, "ours": here, "p99, ours to C": here["p99_ms"] / in_c["p99_ms"],
            "commands": int(wanted), "answered": answered, "refused": wrong,
            "the peer ended by": other.returncode,
        }  # fmt: skip


def _our_turn(count: int) -> Floats:
    """Round trips [ms], shape (count,)."""
    robot = load_robot("go2")
    rng, waits = np.random.default_rng(0), Ticker(1.0 / PHYSICS_DT)
    names = ("position", "velocity", "kp", "kd", "torque")
    taken = np.empty(count)
    link = UnitreeLink(own_domain(), "lo", sends=[COMMANDS], takes=[STATES])
    with closing(UnitreeRobot(link, robot, lockstep=True, trusting=True)) as ours:
        ours.reset()
        for row in range(count):
            command = JointCommand(**{name: rng.normal(size=12) for name in names})
            waits.wait()
            begin_ns = time.monotonic_ns()
            ours.write(command)
            ours.read()
            taken[row] = 1e-6 * (time.monotonic_ns() - begin_ns)
    return taken


def _figures(taken_ms: Floats) -> dict[str, float]:
    came = taken_ms[taken_ms >= 0.0]
    p50, p99 = np.percentile(came, [50, 99])
    return {
        "p50_ms": float(p50), "p99_ms": float(p99), "longest_ms": float(came.max()),
        "lost": int(len(taken_ms) - len(came)),
    }  # fmt: skip
