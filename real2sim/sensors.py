"""Kinds of sensors: which problems a run log poses,
how much of a log they need, and which effects it cannot show.

A fit always finds something. What is named must hold on a part of the log that no fit has seen.
That part, and the parts between which fits are compared, need some seconds each.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats
from saltus.constants import GRAVITY
from saltus.effects.effect import Site
from saltus.effects.profile import EFFECTS
from saltus.errors import SaltusError
from saltus.real2sim.problem.body.problem import BodyProblem
from saltus.real2sim.problem.camera.problem import CameraProblem
from saltus.real2sim.problem.imu import ImuProblem
from saltus.real2sim.problem.joints.problem import JointProblem
from saltus.real2sim.problem.jumps.problem import JumpProblem
from saltus.real2sim.problem.log import (
    drive_torque,
    has_changing_gains,
    robot_of,
    rows_between,
    segments_of,
    table_times,
    why_commands_unknown,
)
from saltus.real2sim.problem.problem import Problem
from saltus.real2sim.saturation_curve import with_curves
from saltus.real2sim.search.findings import SearchFindings
from saltus.recordings.run_log import RunLog
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import JOINTS
from saltus.rotations import rotation_matrix

LEAST_SHARE = 0.5
"""Least share of the robot's weight. In the mean over a log the ground gives all of it; motors a
third weaker than claimed seem to give two thirds."""
EVERY = 5
"""Rows of which one is looked at: drives follow legs, which move below 20 Hz."""


def carried_by(log: RunLog) -> float:
    """Share of the claimed weight that the commanded torques put on the ground,
    in the mean over a log.

    In the mean the forces on a body that ends as it began are its weight, in jumps too; a robot
    that is carried, or hangs, puts none on its feet. Legs are taken as light.

    Args:
        log: With base "free", its pose measured, and the joints of a quadruped in the order of
            `JOINTS`.
    """
    robot, joints, base = robot_of(log), log.joints, log.base
    if base is None:
        raise ValueError("the log has no base.csv")
    part = slice(None, None, EVERY)
    torque = drive_torque(log)[part]
    jacobian = np.asarray(LegKinematics(robot).jacobian(joints.q[part])).swapaxes(-1, -2)
    # On the robot, base frame
    pushed = -np.einsum("nlij,nlj->nli", np.linalg.pinv(jacobian), torque.reshape(-1, 4, 3))
    row = np.clip(np.searchsorted(base.time_s, joints.time_s[part]), 0, len(base.time_s) - 1)
    up = rotation_matrix(base.values[row, 3:7])[:, 2]  # the world's vertical in the base frame
    weight = GRAVITY * (robot.mass + float(log.meta.get("payload_kg") or 0.0))
    return float(np.mean(np.einsum("nli,ni->n", pushed, up)) / weight)


NO_EFFECTS_OF_HARDWARE = ("sample_and_hold", "heightmap_shift")
"""Effects of how a robot is operated, not of its hardware."""

DRIVES: tuple[Site, ...] = ("command", "torque", "joint", "joint_state", "stand")
"""Where the effects act that a held robot's joints show."""
CHANGING_GAINS = (
    "gains change from command to command: replays take one kp and one kd for each joint"
)
STEP_S = 0.1
"""Over which a joint moves or rests: angles of a noise of 1 mrad then tell 0.05 rad/s."""
LEAST_RAD = 0.005
"""In a step, at least: below 0.05 rad/s a joint stands still (`excitation.LEAST_SPEED`)."""
SETTLING_S = 0.5
"""After a motion a joint settles, which tells as much: two periods of a leg under PD control."""


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """One kind of measurement in a run log (joints, camera, body, IMU, jumps), and its problem."""

    name: str
    sites: tuple[Site, ...]
    """Sites of the effects that only it shows."""
    lacks: Callable[[RunLog], str]
    """Says why a log poses no problem of this kind; empty if it does."""
    problem: Callable[[RunLog], Problem]
    lasts_s: Callable[[RunLog], float]
    """Seconds of a log that tell something of it."""
    least_s: float
    """So many it needs before anything is said of its effects."""
    needs: str
    """Needed data, in words."""
    experiment: str
    """Which gets them."""
    prepare_s: float
    """Typical time to prepare the problem [s], for the progress bar."""
    search_s: float
    """Typical time of the search [s]."""

    finished: Callable[[Problem, SearchFindings], SearchFindings] = lambda _, findings: findings
    """Findings with what the log tells of them beyond the unknowns of their problem."""

    def too_short(self, logs: Sequence[RunLog]) -> str:
        """The data that logs together have too little of for anything to be named and tested,
        and how much it takes.

        Empty where they have enough.
        """
        seconds = sum(self.lasts_s(log) for log in logs)
        if round(seconds, 1) >= self.least_s:
            return ""
        who = "joints need" if self.name == "joints" else f"the {self.name} needs"
        return f"{seconds:.2f} s of {self.needs}; {who} {self.least_s:g} s"

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects that only this sensor shows."""
        own = (name for name, kind in EFFECTS.items() if kind.site in self.sites)
        return tuple(name for name in own if name not in NO_EFFECTS_OF_HARDWARE)


def _no_held_base(log: RunLog) -> str:
    if log.meta["base"] != "fixed":
        jumps = not why_commands_unknown(log) and has_changing_gains(log) and not _no_free_base(log)
        return (
            f"the base is not held: "
            f"{'see body' if jumps else 'what the ground does hides the joints'}"
        )
    return why_commands_unknown(log) or (CHANGING_GAINS if has_changing_gains(log) else "")


def _no_images(log: RunLog) -> str:
    if log.depth is None:
        return "no depth images"
    return "" if log.meta.get("camera") else "meta.json claims no camera"


def _no_free_base(log: RunLog) -> str:
    if log.meta["base"] == "fixed":
        return "the base is held"
    if log.base is None:
        return "no measured pose of the base (base.csv)"
    if why_commands_unknown(log):
        return why_commands_unknown(log)
    if tuple(name.removesuffix("_joint") for name in log.meta["joints"]) != JOINTS:
        return (
            f"the joints are not {JOINTS[0]} to {JOINTS[-1]} in this order: "
            "what moves the body is not known"
        )
    try:
        robot = robot_of(log)
    except SaltusError as error:
        return f"what stands there is no quadruped that can be replayed: {error}"
    if (robot.joint_sign < 0.0).any():
        return (
            "the robot's model counts angles the other way: "
            "positive is about x (hip) and y (thigh, calf)"
        )
    share = carried_by(log)
    if share >= LEAST_SHARE:
        return (
            "no IMU data: how it turns at a landing is not known"
            if log.imu is None and has_changing_gains(log)
            else ""
        )
    return f"the robot does not stand on its legs: their drives carry {share:.0%} of its weight"


def _no_imu(log: RunLog) -> str:
    if log.imu is None:
        return "no IMU data"
    is_known = log.base is not None or log.meta["base"] == "fixed"
    return "" if is_known else "the base is not held, and no base.csv says how it moves"


def _body(log: RunLog) -> Problem:
    return JumpProblem(log) if has_changing_gains(log) else BodyProblem(log)


def moving_s(log: RunLog) -> float:
    """Seconds in segments in which a joint moves, or has just moved."""
    between, time_s = rows_between(log.joints.time_s), log.joints.time_s
    total = 0.0
    for segment in segments_of(log):
        rows = between(segment.start_s, np.nextafter(segment.end_s, np.inf))
        total += _moving_s(time_s[rows], log.joints.q[rows])
    return total


def _moving_s(time_s: Floats, q: Floats) -> float:
    """Seconds of one segment, by steps of `STEP_S`."""
    if len(time_s) < 2:
        return 0.0
    step = ((time_s - time_s[0]) / STEP_S).astype(np.int64)
    starts = np.flatnonzero(np.diff(step, prepend=-1))
    reach = np.maximum.reduceat(q, starts) - np.minimum.reduceat(q, starts)
    moves_s = time_s[starts][(reach > LEAST_RAD).any(axis=1)]
    edges = np.append(time_s[starts], time_s[-1])
    since = (
        edges[:-1]
        - np.concatenate([[-np.inf], moves_s])[np.searchsorted(moves_s, edges[:-1], side="right")]
    )
    return float(np.diff(edges)[since <= SETTLING_S].sum())


def _covered_s(table: str) -> Callable[[RunLog], float]:
    """Seconds in segments that a table of a log covers."""

    def covered(log: RunLog) -> float:
        time_s = table_times(log).get(table)
        if time_s is None or not len(time_s):
            return 0.0
        first, last = float(time_s[0]), float(time_s[-1])
        return sum(max(0.0, min(s.end_s, last) - max(s.start_s, first)) for s in segments_of(log))

    return covered


NAMED_FROM_S = 4.0
"""Two motions of two seconds (`saltus.real2sim.search.residual_split.PIECE_S`): one for the fit,
one for the test."""
SENSORS = (
    Sensor(
        name="joints", sites=DRIVES, lacks=_no_held_base, problem=JointProblem, lasts_s=moving_s,
        least_s=NAMED_FROM_S,
        needs="motion", experiment="joint_tour", prepare_s=1.0, search_s=30.0,
        finished=with_curves,
    ),
    Sensor(
        name="camera", sites=("depth", "view"), lacks=_no_images, problem=CameraProblem,
        lasts_s=_covered_s("depth"),
        least_s=NAMED_FROM_S,
        needs="images", experiment="heave_and_pitch", prepare_s=1.0, search_s=4.0,
    ),
    Sensor(
        name="body", sites=("model",), lacks=_no_free_base, problem=_body,
        lasts_s=_covered_s("base"), least_s=NAMED_FROM_S,
        needs="measured poses", experiment="squat", prepare_s=15.0, search_s=10.0,
    ),
    Sensor(
        name="imu", sites=("imu",), lacks=_no_imu, problem=ImuProblem, lasts_s=_covered_s("imu"),
        least_s=NAMED_FROM_S,
        needs="readings", experiment="heave_and_pitch", prepare_s=0.1, search_s=0.5,
    ),
)  # fmt: skip
"""In the order in which they are compared. Of a body standing shows a weight, too."""
