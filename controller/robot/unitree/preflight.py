"""A preflight: a robot is listened to, and, where it hangs and all is well, moved softly."""

from collections.abc import Callable

from saltus.clock import RunClock
from saltus.controller.robot.unitree.link import UnitreeLink
from saltus.controller.robot.unitree.listening import (
    PreflightCheck,
    link_checks,
    listen_to_robot,
    state_checks,
)
from saltus.controller.robot.unitree.motion_service import MotionService
from saltus.controller.robot.unitree.robot import UnitreeRobot
from saltus.controller.robot.unitree.soft_motion import motion_checks, move_softly
from saltus.errors import StackError
from saltus.robots.robot import Robot


def run_preflight(
    link: UnitreeLink,
    kind: Robot,
    clock: RunClock,
    wait: Callable[[], float],
    *,
    stands: bool,
    agreed: Callable[[str], None] = lambda _mode: None,
) -> list[PreflightCheck]:
    """All checks that mean something: the next are made if those before have passed.

    Args:
        link: To the robot; it sends commands and requests, and takes states and answers.
        kind: The robot.
        clock: The run's.
        wait: Returns 2 ms after its last return: the time by that clock [s].
        stands: The robot stands on level ground by itself and is told nothing; else it hangs, and
            its legs are moved.
        agreed: As of `MotionService.release`, for one that hangs and that its own motion service
            moves.

    Raises:
        StackError: another program has begun to command the robot. Nothing is sent then.
    """
    service, mode = _service(MotionService(link), stands=stands, agreed=agreed)
    heard = listen_to_robot(link, wait)
    checks = [service, *link_checks(heard, its_own=int(mode != ""))]
    if not all(check.passed for check in checks):
        return checks
    checks += state_checks(heard, kind, stands=stands)
    if stands or not all(check.passed for check in checks):
        return checks
    robot = UnitreeRobot(link, kind, clock)
    robot.reset()
    checks += motion_checks(move_softly(robot, kind, wait), kind)
    robot.relax()
    return checks


def _service(
    service: MotionService, *, stands: bool, agreed: Callable[[str], None]
) -> tuple[PreflightCheck, str]:
    """The check of the robot's own motion service,
    and the mode in which it still moves the robot.
    """
    mode = refusal = ""
    try:
        mode = service.mode() if stands else service.release(agreed)
    except StackError as error:
        refusal = str(error)
    known = f"mode '{mode}' {'runs' if stands else 'was released'}" if mode else "no mode runs"
    check = PreflightCheck(
        name="service", passed=not refusal, found=refusal or known,
        allowed="any mode, or none" if stands else "none, or one that is released",
        cure="end the mode with the robot's app, or start the robot again",
    )  # fmt: skip
    return check, mode if stands else ""
