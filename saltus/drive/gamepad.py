"""A gamepad that drives a robot, as Linux tells its events (/dev/input/js0)."""

import os
import select
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from saltus.drive.wish import STAND, Wish, moving_wish
from saltus.errors import ConfigError
from saltus.wire.messages import CommandMode

EVENT = struct.Struct("<IhBB")
"""Time [ms], value, type, number: the kernel's joystick API."""
BUTTON, AXIS = 1, 2
INITIAL = 0x80  # of the type: the state when the device was opened, no press
FULL = 32767
DEAD = 0.15
"""Share of a stick's way that counts for none: sticks at rest are up to a tenth off."""
STICKS = {1: ("ahead_mps", -1.2), 0: ("left_mps", -0.5), 3: ("turn_rps", -1.0)}
"""Velocity of a stick that is pushed all the way ahead or to the left: left stick, right stick.

The fastest that policies are trained for. Numbers are those of the drivers of Xbox and PlayStation
pads, on which ahead and left are negative.
"""
MODES = {0: CommandMode.STAND, 1: CommandMode.JUMP, 3: CommandMode.LIE_DOWN}
"""Buttons: A or cross, B or circle, Y or square."""
HELP = (
    "left stick ahead, back and aside, right stick turn, A stand, B jump, Y lie down, Ctrl-C ends"
)


def moved(wish: Wish, kind: int, number: int, value: int) -> Wish:
    """The wish after an event: a pushed stick means to walk, turning goes on with a jump; other
    events change nothing.
    """
    if kind == BUTTON and value and number in MODES:
        return Wish(mode=MODES[number])
    if kind != AXIS or number not in STICKS:
        return wish
    share = max(-1.0, min(1.0, value / FULL))
    pushed = max(0.0, abs(share) - DEAD) / (1.0 - DEAD)
    name, fastest = STICKS[number]
    before = moving_wish(wish, name)
    if wish.mode != before.mode and not pushed:
        return wish
    speed = fastest * (pushed if share > 0.0 else -pushed)
    return replace(before, mode=before.mode, **{name: speed})


class GamepadWish:
    """An open gamepad, as the wish that its events so far make."""

    def __init__(self, device: int) -> None:
        self._device, self._wish, self._rest = device, STAND, b""

    def wish(self) -> Wish | None:
        """The wish now; never waits. None where the gamepad is gone."""
        while select.select([self._device], [], [], 0.0)[0]:
            try:
                new = os.read(self._device, 64 * EVENT.size)
            except OSError:
                return None
            if not new:
                return None
            self._rest += new
            whole = len(self._rest) // EVENT.size * EVENT.size
            for _, value, kind, number in EVENT.iter_unpack(self._rest[:whole]):
                if not kind & INITIAL:
                    self._wish = moved(self._wish, kind, number, value)
            self._rest = self._rest[whole:]
        return self._wish


@contextmanager
def open_gamepad(path: Path) -> Iterator[GamepadWish]:
    """The gamepad at a device; `ConfigError` where it cannot be read."""
    try:
        device = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except OSError as error:
        raise ConfigError(
            f"no gamepad at {path}: {error.strerror}; see ls /dev/input/js*"
        ) from error
    try:
        yield GamepadWish(device)
    finally:
        os.close(device)
