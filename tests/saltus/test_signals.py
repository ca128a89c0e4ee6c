"""Signals that end a command: it cleans up as after Ctrl-C,
and whoever started it learns of the signal.
"""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from saltus.cli.stop_signals import ENDING, Ended, ending_by_signals

SCRIPT = """
import sys, time
from pathlib import Path
from saltus.cli import main as module

class Holding:
    def run(self):
        folder = Path(sys.argv[1])
        try:
            (folder / "begun").touch()
            time.sleep(60)
        except KeyboardInterrupt:
            time.sleep(0.3)
            (folder / "saved").touch()
            if sys.argv[2] == "raises":
                raise
        return 130

module.parse = lambda *arguments, **names: Holding()
sys.exit(module.main([]))
"""


@pytest.mark.sample(2)
@pytest.mark.parametrize("then", ["raises", "returns"])
@pytest.mark.parametrize("number", [signal.SIGINT, *ENDING])
def test_what_a_command_holds_is_saved_also_where_the_signal_comes_twice(
    number: int, then: str, tmp_path: Path
) -> None:
    process = subprocess.Popen([sys.executable, "-c", SCRIPT, str(tmp_path), then])
    while not (tmp_path / "begun").exists():
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(number)
    if number != signal.SIGINT:  # who types Ctrl-C twice insists
        time.sleep(0.1)
        process.send_signal(number)
    assert process.wait(30.0) == (130 if number == signal.SIGINT else -number)
    assert (tmp_path / "saved").exists()


LOADING = """
import sys
from pathlib import Path
from saltus.cli import main as module

class Loading:
    def run(self):
        sys.path.insert(0, sys.argv[1])
        import compiled
        Path(sys.argv[1], "used").touch()
        import time
        time.sleep(60)

module.parse = lambda *arguments, **names: Loading()
sys.exit(module.main([]))
"""
COMPILED = """
import time
from pathlib import Path
try:
    Path(__file__).with_name("begun").touch()
    until = time.monotonic() + 1.0
    while time.monotonic() < until:
        time.sleep(0.01)
except BaseException as error:
    raise ImportError("numpy._core.multiarray failed to import") from None
"""
"""What a compiled module makes of an interruption while it starts."""


@pytest.mark.parametrize("number", [signal.SIGINT, *ENDING])
def test_a_signal_waits_for_modules_that_are_being_imported(number: int, tmp_path: Path) -> None:
    (tmp_path / "compiled.py").write_text(COMPILED)
    process = subprocess.Popen(
        [sys.executable, "-c", LOADING, str(tmp_path)], stderr=subprocess.PIPE, text=True
    )
    while not (tmp_path / "begun").exists():
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(number)
    _, said = process.communicate(timeout=30.0)
    assert (process.returncode, said) == (130 if number == signal.SIGINT else -number, "")


@pytest.mark.parametrize("number", ENDING)
def test_outside_of_a_command_handlers_are_as_before_and_what_is_ignored_stays_so(
    number: signal.Signals,
) -> None:
    before = signal.getsignal(number)
    with pytest.raises(Ended) as ended, ending_by_signals():
        signal.raise_signal(number)
    assert ended.value.number == number
    assert signal.getsignal(number) is before
    signal.signal(number, signal.SIG_IGN)
    try:
        with ending_by_signals():
            signal.raise_signal(number)
    finally:
        signal.signal(number, before)
