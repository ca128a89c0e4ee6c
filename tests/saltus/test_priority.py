"""Processes of a run come before busy programs where they have the right to,
and take their turn where not.
"""

import ctypes
import functools
import os
import subprocess
import sys
import time

import pytest

from saltus.tuning import AUTOGROUP, FIRST, PRIORITY, SLICE_NS

CAP_SYS_NICE, PR_CAPBSET_DROP = 23, 24  # linux/capability.h, linux/prctl.h
SPIN_S = 0.3
SPIN = """
import os, sys, time
from saltus.tuning import AUTOGROUP, prefer_loop, prefer_process
if len(sys.argv) > 1:
    prefer_process(sys.argv[1])
    prefer_loop(sys.argv[1])
print(flush=True)
until_s, before_s = float(input()), time.process_time()
while time.monotonic() < until_s:
    pass
group = AUTOGROUP.read_text().split()[-1] if AUTOGROUP.exists() else "0"
print(os.getpriority(os.PRIO_PROCESS, 0), group, time.process_time() - before_s)
"""


def without_the_right() -> None:
    """Of what is executed next, also as root."""
    ctypes.CDLL(None, use_errno=True).prctl(PR_CAPBSET_DROP, CAP_SYS_NICE, 0, 0, 0)


def spin(*processes: str, right: bool = True, for_s: float = 0.0) -> list[tuple[int, int, float]]:
    """Priority, that of the session, and processor time of programs
    that are busy at the same time on one processor.

    An empty name is a program that is none of Saltus'.
    """
    core = {min(os.sched_getaffinity(0))}

    def begin() -> None:
        os.sched_setaffinity(0, core)
        if not right:
            without_the_right()

    started = [
        subprocess.Popen(
            [sys.executable, "-c", SPIN, *filter(None, [process])],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=begin,
        )
        for process in processes
    ]
    for each in started:
        assert each.stdout is not None
        each.stdout.readline()
    until_s = time.monotonic() + for_s
    for each in started:
        assert each.stdin is not None
        each.stdin.write(f"{until_s}\n")
        each.stdin.flush()
    told = [each.communicate()[0].split() for each in started]
    return [(int(own), int(group), float(time_s)) for own, group, time_s in told]


@functools.cache
def may(asking: str) -> bool:
    """Whether this computer lets its user ask for more."""
    code = f"import os, pathlib; {asking}"
    asked = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, check=False, start_new_session=True
    )
    return asked.returncode == 0


ALONE = f"os.nice({PRIORITY})"
AS_SESSION = f"pathlib.Path('{AUTOGROUP}').write_text('{PRIORITY}')"


@pytest.mark.parametrize("process", ["render", "heightmap", "policy", "controller"])
def test_a_process_is_preferred_where_it_has_the_right_and_takes_its_turn_where_not(
    process: str,
) -> None:
    usual = os.getpriority(os.PRIO_PROCESS, 0)
    ((own, group, _),) = spin(process, right=False)
    assert (own, group) == (usual, 0)
    ((own, group, _),) = spin(process)
    assert own == (FIRST.get(process, usual) if may(ALONE) else usual)
    assert group == (FIRST.get(process, PRIORITY) if may(AS_SESSION) else 0)


def test_the_loop_gets_the_processor_beside_a_busy_program() -> None:
    (_, _, loop_s), (_, _, other_s) = spin("controller", "", for_s=SPIN_S)
    assert loop_s > (2.0 * other_s if may(ALONE) and may(AS_SESSION) else 0.0)


SLICES = """
import ctypes, platform, struct, threading
from saltus.tuning import prefer_process, prefer_this_thread

def tell():
    attributes = ctypes.create_string_buffer(48)
    call = {"x86_64": 315, "aarch64": 275}[platform.machine()]  # sched_getattr(2)
    assert ctypes.CDLL(None).syscall(call, 0, attributes, 48, 0) == 0
    print(struct.unpack("<IIQiIQQQ", attributes)[5])

tell()
with prefer_this_thread():
    tell()
tell()
prefer_process("render")
tell()
threading.Thread(target=tell).start()
"""


def test_slices_of_a_run_are_short_without_any_right() -> None:
    """Those of a supervisor while its run lasts,
    those of a process in all threads that it starts.
    """
    command = [sys.executable, "-c", SLICES]
    told = subprocess.run(
        command, capture_output=True, text=True, check=True, preexec_fn=without_the_right
    ).stdout
    usual, *others = map(int, told.split())
    short = SLICE_NS if usual else 0  # before Linux 6.12 programs have none of their own
    assert others == [short, usual, short, short]
