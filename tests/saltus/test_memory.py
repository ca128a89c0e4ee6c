"""What a supervisor does so that its memory stays as it is."""

import subprocess
import sys
from pathlib import Path

HEAPS = """
import ctypes, sys, threading
from saltus.runtime.memory import use_one_heap

if sys.argv[1] == "one":
    use_one_heap()
libc = ctypes.CDLL(None)
libc.fopen.restype = ctypes.c_void_p
libc.malloc.restype = ctypes.c_void_p
together = threading.Barrier(4)

def allocate():
    together.wait()
    libc.malloc(1000)
    together.wait()

threads = [threading.Thread(target=allocate) for _ in range(4)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
file = ctypes.c_void_p(libc.fopen(sys.argv[2].encode(), b"w"))
libc.malloc_info(0, file)
libc.fclose(file)
"""


def heaps(how: str, tmp_path: Path) -> int:
    """How many a process with four threads has, by glibc's own count."""
    path = tmp_path / "malloc.xml"
    subprocess.run([sys.executable, "-c", HEAPS, how, str(path)], check=True)
    return path.read_text().count("<heap nr=")


def test_threads_share_one_heap(tmp_path: Path) -> None:
    assert heaps("usual", tmp_path) > 1
    assert heaps("one", tmp_path) == 1
