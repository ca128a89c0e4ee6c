"""What a process does so that its memory stays as it is."""

import subprocess
import sys
from pathlib import Path

import pytest

HEAPS = """
import contextlib, ctypes, sys, threading
from saltus.tuning import kept_small

libc = ctypes.CDLL(None)
libc.fopen.restype = ctypes.c_void_p
libc.malloc.restype = ctypes.c_void_p
together = threading.Barrier(4)

def allocate():
    together.wait()
    libc.malloc(1000)
    together.wait()

with kept_small() if sys.argv[1] == "small" else contextlib.nullcontext():
    threads = [threading.Thread(target=allocate) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
file = ctypes.c_void_p(libc.fopen(sys.argv[2].encode(), b"w"))
libc.malloc_info(0, file)
libc.fclose(file)
"""

BACKLOG = """
import contextlib, os, sys, threading, time
from benchmarks._measuring import use_of
from saltus import tuning

tuning.GIVE_BACK_S = 0.05
before_mb = use_of(os.getpid()).memory_mb
with tuning.kept_small() if sys.argv[1] == "small" else contextlib.nullcontext():
    images = [bytes(40_000) + bytes(1) for _ in range(1_000)]
    end = bytes(40_000) + bytes(2)  # behind them: the heap cannot be cut at its end
    high_mb = use_of(os.getpid()).memory_mb - before_mb
    del images
    until_s = time.monotonic() + (20.0 if sys.argv[1] == "small" else 0.5)
    while use_of(os.getpid()).memory_mb - before_mb > 0.5 * high_mb and time.monotonic() < until_s:
        time.sleep(0.01)
assert high_mb > 35.0
assert [thread.name for thread in threading.enumerate()] == ["MainThread"]
open(sys.argv[2], "w").write(str((use_of(os.getpid()).memory_mb - before_mb) / high_mb))
"""


def told(program: str, how: str, path: Path) -> str:
    """What a process wrote."""
    subprocess.run([sys.executable, "-c", program, how, str(path)], check=True)
    return path.read_text()


@pytest.mark.parametrize(("how", "one"), [("usual", False), ("small", True)])
def test_threads_share_one_heap(how: str, one: bool, tmp_path: Path) -> None:
    assert (told(HEAPS, how, tmp_path / "malloc.xml").count("<heap nr=") == 1) == one


@pytest.mark.parametrize(("how", "kept"), [("usual", True), ("small", False)])
def test_what_waited_once_is_given_back(how: str, kept: bool, tmp_path: Path) -> None:
    assert (float(told(BACKLOG, how, tmp_path / "share.txt")) > 0.9) == kept
