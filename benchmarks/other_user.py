"""Can another user of the computer read a run,
send it a plan or stop it? Runs the stack as root, and becomes --uid.

The other user joins with the run's own configuration, at every socket that is open and at every
port of loopback, and signals the process that holds the robot. The owner does the same: what does
not work for him either is not tested.

    saltus bench other_user
"""

import contextlib
import json
import multiprocessing
import os
import signal
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from multiprocessing.pool import Pool
from pathlib import Path
from typing import Any

import zenoh

from benchmarks._command import Command
from benchmarks._kills import ON_FLAT_GROUND
from saltus.errors import SaltusError
from saltus.plan import REST, plan_message
from saltus.resources import shipped_file
from saltus.runtime.run_folder import CLIENT_FILE
from saltus.runtime.stack import Stack
from saltus.wire import codec
from saltus.wire.codec import Envelope
from saltus.wire.joining import LOCAL
from saltus.wire.messages import PlanStatus

FORK = multiprocessing.get_context("fork")  # another user may not be able to read the installation
LISTEN_S = 1.0
CONNECT_MS = 300
LISTENS = "0A"  # of /proc/net/tcp
SENDER = b"the other's plan"
"""By which its plan is known among those that arrive."""


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    uid: int = 65534
    """Uid of the other user; 65534 is nobody."""

    def measure(self) -> dict[str, Any]:
        if os.geteuid() != 0:
            raise SaltusError("bench other_user becomes another user, which only root can")
        users = {"the other user": self.uid, "the owner": os.getuid()}
        with contextlib.ExitStack() as stack:  # all before there is a run: Zenoh cannot be forked
            pools = {name: FORK.Pool(1, os.setuid, (uid,)) for name, uid in users.items()}
            for pool in pools.values():
                stack.callback(pool.join)
                stack.callback(pool.close)
            return {name: attempts(pool) for name, pool in pools.items()}


def attempts(user: Pool) -> dict[str, str]:
    """Returns what a user manages against a run of the stack."""
    with tempfile.TemporaryDirectory() as directory:
        folder = Path(directory)
        folder.chmod(0o755)  # as folders in most homes
        config = replace(ON_FLAT_GROUND, speed=0.25)
        with Stack(config, folder) as stack:
            plans, met = stack.latest("policy/plan"), False
            trial = user.apply_async(attack, (folder, config.prefix))
            while not trial.ready():
                stack.wait(0.01)
                sample = plans.take()
                met = met or (sample is not None and sample.envelope.boot_id == SENDER)
            stops = user.apply(terminate, (stack.pid("controller"),))
        done = {"reads a topic": trial.get(), "puts a plan": met, "stops the run": stops}
    return {what: "yes" if managed else "no" for what, managed in done.items()}


def attack(folder: Path, prefix: str) -> bool:
    """Puts a plan into every session that can be opened.

    Returns whether anything was heard in any.
    """
    heard: list[str] = []
    plan = codec.encode_message(plan_message(REST, PlanStatus.GO))
    for session in sessions(folder):
        subscriber = session.declare_subscriber(
            "**", lambda sample: heard.append(str(sample.key_expr))
        )
        deadline_s, sequence = time.monotonic() + LISTEN_S, 0
        while time.monotonic() < deadline_s:
            sequence += 1
            session.put(
                f"{prefix}/policy/plan", plan, attachment=Envelope(sequence, 0, SENDER).to_bytes()
            )
            time.sleep(0.01)
        subscriber.undeclare()
        session.close()
    return bool(heard)


def sessions(folder: Path) -> Iterator[Any]:
    """Sessions with the run's own configuration, if it can be read,
    at each socket and at each port of loopback.
    """
    settings = []
    with contextlib.suppress(zenoh.ZError, OSError):
        settings.append(zenoh.Config.from_file(str(folder / CLIENT_FILE)))
    all_may_read = (Path(f"/proc/net/{kind}") for kind in ("tcp", "unix"))
    tcp, unix = (path.read_text(encoding="utf-8").splitlines()[1:] for path in all_may_read)
    fields = [line.split()[1:4] for line in tcp]
    endpoints = {
        f"tcp/127.0.0.1:{int(local.split(':')[1], 16)}"
        for local, _, state in fields
        if state == LISTENS
    }
    endpoints |= {
        f"{LOCAL}{path}" for path in (line.split()[-1] for line in unix) if "/saltus-" in path
    }
    for endpoint in sorted(endpoints):
        settings.append(zenoh.Config.from_file(str(shipped_file("zenoh_cfg/client.json5"))))
        settings[-1].insert_json5("connect/endpoints", json.dumps([endpoint]))
        settings[-1].insert_json5("connect/timeout_ms", str(CONNECT_MS))
    for each in settings:
        with contextlib.suppress(zenoh.ZError):
            yield zenoh.open(each)


def terminate(pid: int) -> bool:
    """True where a process can be told to end."""
    try:
        os.kill(pid, signal.SIGTERM)
    except PermissionError:
        return False
    return True
