"""Compares the gains that a log claims with those that the drives' own torque shows.

`tau_est` of each joint is regressed on what its PD law sees: position error, velocity error and
feed-forward torque. The command packet may be late, so the regression is repeated for several
delays and the best one counts. Where gains come with each command, errors count by their share of
the largest one.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Indices
from saltus.real2sim.problem.log import gains_in_force, joint_rates, why_commands_unknown
from saltus.real2sim.screening.angles import rate_slopes
from saltus.real2sim.screening.causes import TorqueCauses, cause_faults, torque_causes
from saltus.real2sim.screening.channel_scales import LogFault, gear_reductions, unit_fault
from saltus.recordings.run_log import JointTable, RunLog

DELAYS_S = np.linspace(0.0, 0.04, 41)
"""Delays of the command packet that are tried [s]: each row of a 500 Hz log and halfway between
two, beyond the 25 ms that published methods look for."""
STEP_PARTS_S = (0.0005, 0.0015)
"""Times within a drive's step of 2 ms at which its command is looked up: a packet that arrives
halfway counts for half of the step."""
FEEDFORWARD_DELAYS_S = (0.0, 0.002, 0.005, 0.01, 0.015, 0.02, 0.025)
"""Delays of the feed-forward torque behind the packet [s]. All of them are columns of one
regression."""
ROWS = 3000
"""Rows that are used. With torque noise of 0.5 Nm and errors of 0.01 rad the standard error of kp
is then 0.5 / (0.01 sqrt(3000)) = 0.9 Nm/rad, 3 % of a kp of 30."""
SINGULAR = 1e-10
"""Share of the largest singular value below which a column only repeats others."""

LEAST_ERROR_RAD = 0.01
"""RMS of the position error from which kp can be read. Noise n of a column with RMS s makes its
coefficient too small by (n / s)^2: encoder noise of 2 mrad costs 4 %, a third of `KP_TOLERANCE`."""
LEAST_RATE_RAD_S = 0.3
"""RMS of the velocity error from which kd can be read: noise of 0.05 rad/s costs 3 % by the same
rule."""
LEAST_TORQUE_NM = 1.0
"""RMS of a torque from which it can be judged: twice the largest noise of a drive's torque, 0.5
Nm."""
LEAST_FEEDFORWARD = 0.2
"""Feed-forward torque as a share of the torque, RMS both, from which its weight is read."""
LEAST_TORQUE_TO_RESIDUAL = 3.0
"""Ratio of torque to residual below which a false delay may explain as much as the true one. In a
quiet chirp of held calves, with a ratio of 2.2, commands 37 ms late and a negative kp explained
more of the torque than the truth."""

KP_TOLERANCE = 0.12
"""Share by which kp may differ from the claim. Healthy logs with strong effects stay within 0.03
(17 logs, of experiments and of the benchmark)."""
RATE_TOLERANCE = 0.15
"""Share by which dq must differ from the rate of q, and kp may differ from that, so that angles are
told."""
KD_TOLERANCE = 0.2
"""Share by which kd may differ from the claim; the logs above stay within 0.05."""
LEAST_KD = 0.3
"""Smaller claims are judged like this one [Nm s/rad]: the tolerance is then 0.06, which at a kp of
30 is the damping that a delay of one row of 2 ms takes away."""
STANDARD_ERRORS = 10.0
"""Standard errors of white noise that are added to the tolerances. Drive noise lasts for several
samples: kp of the same logs is off by up to 3.3 of them."""

LARGEST_RESIDUAL_NM = 0.5
"""RMS of the residual from which the drive follows another encoder than the logged one: the largest
torque noise."""
LARGEST_RESIDUAL_SHARE = 0.1
"""RMS of that residual as a share of the torque's RMS, for strong motions; the larger limit
counts."""
HALF_BACKLASH_RAD = 0.009
"""Half of one degree: the PD law sees the motor's side of a backlash, the log the joint's side."""
SIGN_TORQUE_NM = 0.5
"""Torque beyond which its sign is not noise. The sign says on which side of the backlash the motor
pushes."""
LEAST_EXPLAINED = 0.4
"""Share of the torque's variance below which the columns belong to different joints. In the joint
tour the columns of another joint explain 0.23 to 0.28 of a torque, a joint's own at least 0.88."""
FOLLOWED_FEEDFORWARD = 0.88
"""Weight of the feed-forward torque below which gains cannot be read, where the fit explains less
than `EXPLAINED` as well. A drive adds this torque whatever it measures; in healthy logs its weight
is 0.98 or more. Wide backlash takes the same share from it and from the gains (0.70 to 0.77 where
kp lost 0.17 to 0.25); wrong gains take nothing from it."""
EXPLAINED = 0.9
"""Share of the torque's variance that gains and feed-forward explain in healthy logs (0.95 or
more). Beside wide backlash it was 0.76 to 0.84. A torque in another unit is explained as well as
ever."""


def gain_faults(log: RunLog) -> Iterator[LogFault]:
    """Faults of kp, kd and of the signs of torques, from `tau_est`.

    Yields none if the log lacks `tau_est`, or commands or claimed gains (`why_commands_unknown`).
    """
    if log.joints.tau_est is None or why_commands_unknown(log):
        return
    names, drives = log.meta["joints"], _regressions(log, log.joints.tau_est)
    scaled = list(cause_faults(names, [drive.causes for drive in drives], gear_reductions(log)))
    yield from scaled or chain.from_iterable(map(_faults, names, drives))


def angle_scale_faults(log: RunLog) -> Iterator[LogFault]:
    """A fault of q and q_des together: dq is the rate of q,
    and the drives' kp is as claimed, but for one factor.
    """
    joints = log.joints
    if joints.tau_est is None or joints.dq is None or why_commands_unknown(log):
        return
    slopes = rate_slopes(joints.time_s, joints.q, joints.dq)
    if slopes is None or not np.isfinite(slopes).any():
        return
    slope = float(np.nanmedian(slopes))
    if slope <= 0.0 or abs(np.log(slope)) < np.log1p(RATE_TOLERANCE):
        return
    drives = [drive.causes for drive in _regressions(log, joints.tau_est)]
    factors = [drive.of["kp"].factor for drive in drives if "kp" in drive.of]
    if len(factors) <= 0.5 * len(drives):
        return
    factor = float(np.median(factors))
    # nearer to the claim it is dq that reads too fast or too slow
    if abs(factor / slope - 1.0) < min(RATE_TOLERANCE, abs(factor - 1.0)):
        than = "what dq and kp say"
        yield unit_fault(
            "angle_unit", "q", "q and q_des of all joints", 1.0 / slope, than, gear_reductions(log)
        )


def _regressions(log: RunLog, torque: Floats) -> list["_Regression"]:
    """Regressions of the drives, one for each joint.

    Arrays of shape (joints, rows), as regressions read them.
    """
    joints, told = log.joints, gains_in_force(log)
    rows = np.linspace(0, len(torque) - 1, min(ROWS, len(torque))).astype(int)
    row_s = joints.time_s[rows]
    q, dq, torques = (
        np.ascontiguousarray(each[rows].T) for each in (joints.q, joint_rates(joints), torque)
    )
    gains = [np.max(each, axis=0) for each in told]
    shares = [  # of the largest gain
        each / np.where(top > 0.0, top, np.inf) + (top == 0.0)
        for each, top in zip(told, gains, strict=True)
    ]
    kp, kd = (each[:, None] for each in gains)
    stiffness, damping = (_Commands(joints, share) for share in shares)
    position = _Commands(joints, shares[0] * joints.commanded_q)
    velocity = None if joints.dq_des is None else _Commands(joints, shares[1] * joints.dq_des)
    feedforward = None
    if joints.tau_ff is not None and np.ptp(joints.tau_ff) > 0:
        feedforward = _Commands(joints, joints.tau_ff)
    columns = np.ones(
        (len(q), 4 + (0 if feedforward is None else len(FEEDFORWARD_DELAYS_S)), len(rows))
    )
    drives = [
        _Regression(
            torque=own,
            kp=float(k),
            kd=float(d),
            is_stiff=share[rows] > 0.0,
            has_rate=joints.dq is not None,
        )
        for own, k, d, share in zip(torques, *gains, shares[0].T, strict=True)
    ]
    for delay in DELAYS_S:
        sent = _in_force(joints, row_s - delay)
        error = position.mean(sent) - stiffness.mean(sent) * q
        rate = -damping.mean(sent) * dq
        if velocity is not None:
            rate += velocity.mean(sent)
        columns[:, 0], columns[:, 1] = error, rate
        # backlash shifts what the drive sees by half its width, to the side to which it pushes
        columns[:, 2] = np.tanh((kp * error + kd * rate) / SIGN_TORQUE_NM)
        if feedforward is not None:
            for i, late in enumerate(FEEDFORWARD_DELAYS_S):
                columns[:, 4 + i] = feedforward.of_age(row_s - delay - late, delay + late)
        _keep_best(drives, columns, torques)
    return drives


def _in_force(joints: JointTable, when_s: Floats) -> tuple[Indices, Indices]:
    """Rows of the commands in force at two instants in the step
    of a drive that begins at given times.
    """
    first, second = (
        np.searchsorted(joints.time_s, when_s + part, side="right") - 1 for part in STEP_PARTS_S
    )
    last = len(joints.time_s) - 1
    return np.clip(first, 0, last), np.clip(second, 0, last)


class _Commands:
    """Commands as drives have had them, from a table of shape (rows, joints)."""

    def __init__(self, joints: JointTable, commands: Floats) -> None:
        self._joints, self._commands = joints, np.ascontiguousarray(commands.T, dtype=np.float64)
        self._is_constant = bool(np.all(commands == commands[0]))
        self._known: dict[float, tuple[tuple[Indices, Indices], Floats]] = {}

    def mean(self, rows: tuple[Indices, Indices]) -> Floats:
        """Over the steps of the drives, shape (joints, rows),
        or (joints, 1) where all commands are alike.
        """
        if self._is_constant:
            return self._commands[:, :1]
        first, second = (np.take(self._commands, each, axis=1) for each in rows)
        first += second
        first /= 2
        return first

    def of_age(self, when_s: Floats, age_s: float) -> Floats:
        """Mean commands over steps that begin at given times, by their age.

        Two sums of delays that make one age are looked up once.
        """
        rows, key = _in_force(self._joints, when_s), round(age_s, 6)
        known = self._known.get(key)
        if known is None or not all(
            np.array_equal(*both) for both in zip(known[0], rows, strict=True)
        ):
            known = self._known[key] = rows, self.mean(rows)
        return known[1]


@dataclass(kw_only=True, eq=False)
class _Regression:
    """Least squares of a drive's torque at the delay that explains most.

    The columns are in the order error, rate, side of the backlash, constant, feed-forward.
    """

    torque: Floats
    kp: float
    """Claimed, the largest of the log; so is `kd`."""
    kd: float
    is_stiff: NDArray[np.bool_]
    """Rows in which the drive has stiffness."""
    has_rate: bool
    """True where velocities are measured."""
    matrix: Floats = field(default_factory=lambda: np.empty((0, 0)))
    """The columns, shape (columns, rows)."""
    inverse: Floats = field(default_factory=lambda: np.empty(0))
    solution: Floats = field(default_factory=lambda: np.empty(0))
    rest: Floats = field(default_factory=lambda: np.empty(0))
    explained: float = -np.inf
    """Share of the torque's variance."""

    @property
    def causes(self) -> TorqueCauses:
        """Factors that may be wrong."""
        feedforward = self.matrix[4] if len(self.matrix) > 4 else None
        error, rate = self.kp * self.matrix[0], self.kd * self.matrix[1]
        return torque_causes(self.torque, error, rate, feedforward, is_rate_measured=self.has_rate)


def _keep_best(drives: list[_Regression], columns: Floats, torques: Floats) -> None:
    """Takes the regressions that explain more than those of other delays.

    All joints at once: most of the time of small matrices is that of a call. Columns have the shape
    (joints, columns, rows), torques (joints, rows).
    """
    squares = columns @ columns.mT
    inverse = np.asarray(np.linalg.pinv(squares, rcond=SINGULAR, hermitian=True), dtype=np.float64)
    solution = (inverse @ (columns @ torques[..., None]))[..., 0]
    rest = torques - (solution[:, None] @ columns)[:, 0]
    explained = 1 - np.var(rest, axis=1) / np.maximum(np.var(torques, axis=1), 1e-12)
    for joint, drive in enumerate(drives):
        if explained[joint] > drive.explained or not len(drive.matrix):
            drive.matrix, drive.explained = columns[joint].copy(), float(explained[joint])
            drive.inverse, drive.solution, drive.rest = inverse[joint], solution[joint], rest[joint]


def _faults(name: str, drive: _Regression) -> Iterator[LogFault]:
    torque_nm = float(np.var(drive.torque)) ** 0.5
    left = torque_nm * (1.0 - drive.explained) ** 0.5
    stiff = drive.is_stiff
    followed = 1 - float(np.var(drive.rest[stiff])) / max(float(np.var(drive.torque[stiff])), 1e-12)
    is_judged = (
        torque_nm > LEAST_TORQUE_NM and left > LARGEST_RESIDUAL_NM + drive.kp * HALF_BACKLASH_RAD
    )
    if is_judged and followed < LEAST_EXPLAINED:
        text = (
            f"q, q_des and gains explain {followed:.0%} of tau_est of {name}: "
            "the columns are not of one joint"
        )
        yield LogFault(name="torque_unexplained", text=text)
        return
    is_other_encoder = left > max(LARGEST_RESIDUAL_NM, LARGEST_RESIDUAL_SHARE * torque_nm)
    is_faint = (
        np.std(drive.matrix[0]) < LEAST_ERROR_RAD or torque_nm < LEAST_TORQUE_TO_RESIDUAL * left
    )
    if is_other_encoder or is_faint:
        return
    shown, margin = (
        float(drive.solution[0]),
        STANDARD_ERRORS * float(np.sqrt(np.var(drive.rest) * drive.inverse[0, 0])),
    )
    if shown < -margin:
        text = (
            f"tau_est of {name} pushes away from q_des (kp {shown:.3g}, claimed {drive.kp:.3g}): "
            "a sign is flipped"
        )
        yield LogFault(name="flipped_sign", text=text)
        return
    has_feedforward = (
        len(drive.matrix) > 4 and np.std(drive.matrix[4]) > LEAST_FEEDFORWARD * torque_nm
    )
    is_read = drive.explained > EXPLAINED or drive.solution[4:].sum() >= FOLLOWED_FEEDFORWARD
    if is_read or not has_feedforward:
        yield from _wrong_gains(name, drive, shown, margin)


def _wrong_gains(name: str, drive: _Regression, shown: float, margin: float) -> Iterator[LogFault]:
    """A kp beyond its tolerance, which is wider by a margin of chance,
    or a kd where kp is right.
    """
    kp, kd, shown_kd = drive.kp, drive.kd, float(drive.solution[1])
    if abs(shown - kp) > KP_TOLERANCE * kp + margin:
        yield LogFault(
            name="wrong_gains",
            text=f"tau_est of {name} shows kp {shown:.3g}, meta.json claims {kp:.3g}",
        )
        return
    is_told = abs(shown - kp) < KP_TOLERANCE * kp and np.std(drive.matrix[1]) > LEAST_RATE_RAD_S
    if is_told and abs(shown_kd - kd) > KD_TOLERANCE * max(kd, LEAST_KD) + margin * kd / kp:
        yield LogFault(
            name="wrong_gains",
            text=f"tau_est of {name} shows kd {shown_kd:.3g}, meta.json claims {kd:.3g}",
        )
