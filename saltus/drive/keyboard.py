"""Keys of a terminal that drive a robot."""

import os
import select
import sys
import termios
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from saltus.drive.wish import STAND, Wish, moving_wish
from saltus.wire.messages import CommandMode

STEP = 0.2
"""Change of a velocity with each press [m/s], [rad/s]: five or six presses to a policy's
fastest."""
MOST = 1.2
VELOCITIES = {
    "w": ("ahead_mps", STEP),
    "s": ("ahead_mps", -STEP),
    "a": ("turn_rps", STEP),
    "d": ("turn_rps", -STEP),
    "q": ("left_mps", STEP),
    "e": ("left_mps", -STEP),
}
MODES = {" ": CommandMode.STAND, "j": CommandMode.JUMP, "l": CommandMode.LIE_DOWN}
HELP = "w s ahead and back, a d turn, q e aside, space stand, j jump, l lie down, Ctrl-C ends"


def pressed(wish: Wish, key: str) -> Wish:
    """The wish after a key: velocities add up and mean to walk, turning goes on with a jump; other
    keys change nothing.
    """
    if key in MODES:
        return Wish(mode=MODES[key])
    if key not in VELOCITIES:
        return wish
    name, step = VELOCITIES[key]
    before = moving_wish(wish, name)
    value = round(min(max(getattr(before, name) + step, -MOST), MOST), 6)
    return replace(before, **{name: value})


class KeyboardWish:
    """Keys of an open terminal, as the wish that those pressed so far make."""

    def __init__(self, terminal: int) -> None:
        self._terminal, self._wish = terminal, STAND

    def wish(self) -> Wish:
        """The wish now; never waits."""
        while select.select([self._terminal], [], [], 0.0)[0]:
            keys = os.read(self._terminal, 64).decode("ascii", errors="ignore")
            if not keys:  # its end
                break
            for key in keys:
                self._wish = pressed(self._wish, key)
        return self._wish


@contextmanager
def unbuffered_keys(terminal: int) -> Iterator[KeyboardWish]:
    """Keys as they are pressed, without Enter; the terminal is as before afterwards."""
    before = termios.tcgetattr(terminal)
    try:
        tty.setcbreak(terminal)
        sys.stderr.write(f"{HELP}\n")
        yield KeyboardWish(terminal)
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
