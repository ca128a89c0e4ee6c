"""The service of a Unitree that says which of its own programs moves it,
and takes the robot from that program.
"""

import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from saltus.controller.robot.unitree.link import (
    ANSWER_TYPE,
    ANSWERS,
    COMMANDS,
    REQUEST_TYPE,
    REQUESTS,
    UnitreeLink,
)
from saltus.errors import MessageError, StackError
from saltus.recordings import ros_messages as ros

CHECK_MODE, RELEASE_MODE = 1001, 1003
"""Calls of the service `motion_switcher` (Unitree's unitree_sdk2, BSD-3)."""
DONE, REFUSED, UNKNOWN_CALL = 0, 7008, 3203
"""Codes of an answer: well; the mode was not released; no such call (the same source)."""
ANSWER_S = 1.0
"""An answer takes so long at most, by the time limit of Unitree's own clients."""
TRIES = 3
RELEASED_S = 5.0
"""A mode that was released has ended within this: the time limit in Unitree's examples."""


class MotionService:
    """The service of a robot that moves it by itself, as we ask it over DDS: for its mode, and to
    release the robot.

    Args:
        link: To the robot; it sends `REQUESTS` and takes `ANSWERS`.
    """

    def __init__(self, link: UnitreeLink) -> None:
        self._link = link

    def mode(self) -> str:
        """Name of the mode in which the robot's own program moves it.

        Empty where none does, and where there is no such service: unitree_mujoco has none.

        Raises:
            StackError: the service does not answer, or refuses to tell.
        """
        while not self._link.has_met_all:
            self._link.wait(ANSWERS, ANSWER_S)
        if not self._link.others(ANSWERS):
            return ""
        code, data = self._call(CHECK_MODE)
        try:
            name = json.loads(data)["name"] if code == DONE else None
        except (ValueError, KeyError, TypeError):
            name = None
        if not isinstance(name, str):
            raise StackError(
                f"the robot's motion service does not tell its mode (code {code}): nothing is "
                "sent; start the robot again"
            )
        return name

    def release(self, agreed: Callable[[str], None] = lambda _mode: None) -> str:
        """Takes the robot from its own program; a robot that stands sinks to the ground.

        Args:
            agreed: Called with the mode before it is released, if one runs; returns once a person
                has agreed.

        Returns:
            The mode that ran; empty if none did.

        Raises:
            StackError: it was not released.
        """
        mode = self.mode()
        if not mode:
            return mode
        agreed(mode)
        code, _ = self._call(RELEASE_MODE)
        until_s = time.monotonic() + RELEASED_S
        while code == DONE and time.monotonic() < until_s:
            if not self.mode() and not self._link.others(COMMANDS):
                return mode
            self._link.wait(ANSWERS, 0.1 * ANSWER_S)
        if code == DONE and not self.mode():
            return mode  # who else commands the robot is told by those who look for it
        raise StackError(
            f"the robot's motion service runs mode '{mode}' and was not released (code {code}): "
            "nothing is sent; end the mode with the robot's app, or start the robot again"
        )

    def _call(self, call: int) -> tuple[int, str]:
        """Code and data of the answer; asked again where none comes, as requests can be lost."""
        self._link.take(ANSWERS)
        for _ in range(TRIES):
            number = time.monotonic_ns()
            self._link.send(REQUESTS, request(call, number))
            until_s = time.monotonic() + ANSWER_S
            while (left_s := until_s - time.monotonic()) > 0.0:
                for arrived in self._link.take(ANSWERS):
                    if (answer := _answer_to(number, arrived.payload)) is not None:
                        return answer
                self._link.wait(ANSWERS, left_s)
        raise StackError(
            f"the robot's motion service has not answered for {TRIES * ANSWER_S:g} s: nothing is "
            "sent; start the robot again"
        )


class SimulatedMotionService:
    """A simulated robot's motion service, which answers requests for its mode and for release."""

    def __init__(self) -> None:
        self.released = False
        """True once it was told to release a mode that it lets go."""

    def answer(self, payload: bytes, mode: str, *, keeps: bool) -> list[bytes]:
        """The answers to a request; none to bytes that are no request.

        Args:
            payload: The request, as it travels.
            mode: The mode that runs; empty if none does.
            keeps: It does not let the mode be released.
        """
        try:
            asked = ros.decode_ros_message(REQUEST_TYPE, payload).header.identity
        except MessageError:
            return []
        code, data = DONE, ""
        if asked.api_id == CHECK_MODE:
            data = json.dumps({"form": "0", "name": mode})
        elif asked.api_id == RELEASE_MODE:
            self.released = not keeps
            code = REFUSED if mode and keeps else DONE
        else:
            code = UNKNOWN_CALL
        header = _make("ResponseHeader", identity=asked, status=_make("ResponseStatus", code=code))
        return [ros.payload_of(_make("Response", header=header, data=data, binary=_NOTHING))]


_NOTHING = np.zeros(0, np.uint8)


def request(call: int, number: int) -> bytes:
    """A request with its number, by which its answer is known, as it travels."""
    header = _make(
        "RequestHeader", identity=_make("RequestIdentity", id=number, api_id=call),
        lease=_make("RequestLease", id=0),
        policy=_make("RequestPolicy", priority=0, noreply=False),
    )  # fmt: skip
    return ros.payload_of(_make("Request", header=header, parameter="{}", binary=_NOTHING))


def _answer_to(number: int, payload: bytes) -> tuple[int, str] | None:
    try:
        answer = ros.decode_ros_message(ANSWER_TYPE, payload)
    except MessageError:
        return None
    header = answer.header
    return (header.status.code, answer.data) if header.identity.id == number else None


def _make(name: str, **fields: Any) -> Any:
    return ros.make(f"unitree_api/msg/{name}", **fields)
