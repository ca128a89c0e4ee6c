"""A preflight: a robot is listened to, and, where it hangs and all is well, moved softly."""

from collections.abc import Callable

from saltus.clock import RunClock
from saltus.controller.robot.unitree.link import UnitreeLink
from saltus.controller.robot.unitree.listening import Check, link_checks, listen, state_checks
from saltus.controller.robot.unitree.robot import UnitreeRobot
from saltus.controller.robot.unitree.soft_motion import motion_checks, move
from saltus.robots.robot import Robot


def preflight(
    link: UnitreeLink, kind: Robot, clock: RunClock, wait: Callable[[], float], *, stands: bool
) -> list[Check]:
    """All checks that mean something: the next are made if those before have passed.

    Args:
        link: To the robot; it sends commands and takes states.
        kind: The robot.
        clock: The run's.
        wait: Returns 2 ms after its last return: the time by that clock [s].
        stands: The robot stands on level ground by itself and is told nothing; else it hangs, and
            its legs are moved.

    Raises:
        StackError: another program has begun to command the robot. Nothing is sent then.
    """
    heard = listen(link, wait)
    checks = link_checks(heard)
    if not all(check.passed for check in checks):
        return checks
    checks += state_checks(heard, kind, stands=stands)
    if stands or not all(check.passed for check in checks):
        return checks
    robot = UnitreeRobot(link, kind, clock)
    robot.reset()
    checks += motion_checks(move(robot, kind, wait), kind)
    robot.relax()
    return checks
