"""Compares the gains that a log claims with those that the drive's own torque shows."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.real2sim.problem.log import gains
from saltus.real2sim.screening.fault import Fault
from saltus.recordings.run_log import JointTable, RunLog

MAX_DELAY_S = 0.04  # of a command packet: the largest that is looked for, and more
DELAYS = 21
ROWS = 3000  # enough for three numbers
FF_DELAYS_S = (0.0, 0.002, 0.005, 0.01, 0.015, 0.02, 0.025)  # of the feed-forward torque behind the packet
SEEN_ERROR = 0.01  # rad RMS: a noise of 2 mrad makes kp 4 % too small
SEEN_RATE = 0.3  # rad/s RMS: a noise of 0.05 rad/s makes kd 3 % too small
SEEN_TORQUE = 1.0  # Nm RMS, from which on noise (0.5 at most) cannot hide what a torque follows
SEEN_OVER_LEFT = 2.0  # torque over what is left: less, and a false delay may explain as much as the true one
KP_OFF, KD_OFF = 0.12, 0.2  # of the claim; healthy logs with strong effects stay within 0.03
MIN_KD = 0.3  # Nm s/rad: claims of less are judged like this one
LEFT, LEFT_SHARE = 0.5, 0.1  # Nm, or share of the RMS: more, and the drive follows another encoder than the logged one
FAINT_TORQUE = 0.5  # Nm: beyond it the sign of a torque is no noise
SURE = 10.0  # standard errors of samples that were independent; noise of drives lasts for a few samples
HALF_PLAY = 0.009  # rad, half of 1 degree of backlash: the law sees the motor's side, the log the joint's
SENSELESS = 0.4  # share of the variance below which the torque belongs to other columns


def gain_faults(log: RunLog) -> list[Fault]:
    """Faults of kp, kd and of the signs of torques, from `tau_est`; none without it."""
    if log.joints.tau_est is None:
        return []
    names = log.meta["joints"]
    kp, kd = gains(log.meta)
    fits = _fits(log.joints, log.joints.tau_est, kp, kd)
    return [f for j, name in enumerate(names) for f in _faults(name, fits[j], float(kp[j]), float(kd[j]))]


@dataclass(frozen=True, kw_only=True)
class _Fit:
    """The torque that a drive believes, regressed on the errors it sees, at the delay that explains most."""

    explained: float
    """Share of the torque's variance."""
    kp: float
    doubt: float
    """How far kp may be off by chance."""
    kd: float
    feedforward: float
    """Weight of the feed-forward torque, 1 in a healthy log."""
    error: float
    """RMS [rad], as the others."""
    rate: float
    torque: float
    feedforward_seen: float


def _fits(joints: JointTable, torque: Floats, kp: Floats, kd: Floats) -> list[_Fit]:
    rows = np.linspace(0, len(torque) - 1, min(ROWS, len(torque))).astype(int)
    dq = np.gradient(joints.q, joints.time_s, axis=0) if joints.dq is None else joints.dq
    best: dict[int, _Fit] = {}
    for delay in np.linspace(0, MAX_DELAY_S, DELAYS):
        held = _rows_in_force(joints.time_s, joints.time_s[rows] - delay)
        error = joints.q_des[held] - joints.q[rows]
        rate = -dq[rows] if joints.dq_des is None else joints.dq_des[held] - dq[rows]
        # Play shifts what the drive sees by half its width, to the side to which it pushes
        columns = [error, rate, np.tanh((kp * error + kd * rate) / FAINT_TORQUE), np.ones_like(error)]
        if joints.tau_ff is not None and np.ptp(joints.tau_ff) > 0:
            late = [_rows_in_force(joints.time_s, joints.time_s[rows] - delay - d) for d in FF_DELAYS_S]
            columns += [joints.tau_ff[index] for index in late]
        for joint in range(torque.shape[1]):
            fit = _regress([column[:, joint] for column in columns], torque[rows, joint])
            if joint not in best or fit.explained > best[joint].explained:
                best[joint] = fit
    return [best[joint] for joint in range(torque.shape[1])]


def _rows_in_force(time_s: Floats, when_s: Floats) -> NDArray[np.intp]:
    """Rows of the commands in force at given times."""
    return np.clip(np.searchsorted(time_s, when_s, side="right") - 1, 0, len(time_s) - 1)


def _regress(columns: list[Floats], torque: Floats) -> _Fit:
    matrix = np.stack(columns)
    square = matrix @ matrix.T
    inverse = np.linalg.pinv(square, rcond=1e-10, hermitian=True)
    solution = inverse @ (matrix @ torque)
    left, variance = float(np.var(torque - solution @ matrix)), float(np.var(torque))
    return _Fit(
        explained=1 - left / max(variance, 1e-12),
        kp=float(solution[0]),
        doubt=SURE * float(np.sqrt(left * inverse[0, 0])),
        kd=float(solution[1]),
        feedforward=float(solution[4:].sum()),
        error=float(np.std(columns[0])),
        rate=float(np.std(columns[1])),
        torque=variance**0.5,
        feedforward_seen=float(np.std(columns[4])) if len(columns) > 4 else 0.0,
    )


def _faults(name: str, fit: _Fit, kp: float, kd: float) -> Iterator[Fault]:
    left = fit.torque * (1 - fit.explained) ** 0.5
    if fit.torque > SEEN_TORQUE and fit.explained < SENSELESS and left > LEFT + kp * HALF_PLAY:
        text = f"q, q_des and gains explain {fit.explained:.0%} of tau_est of {name}: the columns are not of one joint"
        yield Fault(name="torque_unexplained", text=text)
        return
    if left > max(LEFT, LEFT_SHARE * fit.torque) or fit.error < SEEN_ERROR or fit.torque < SEEN_OVER_LEFT * left:
        return
    if fit.kp < -fit.doubt:
        text = f"tau_est of {name} pushes away from q_des (kp {fit.kp:.3g}, claimed {kp:.3g}): a sign is flipped"
        yield Fault(name="flipped_sign", text=text)
        return
    if abs(fit.kp - kp) > KP_OFF * kp + fit.doubt:
        text = f"tau_est of {name} shows kp {fit.kp:.3g}, meta.json claims {kp:.3g}"
        yield Fault(name="wrong_gains", text=text)
    elif (
        abs(fit.kp - kp) < KP_OFF * kp
        and fit.rate > SEEN_RATE
        and abs(fit.kd - kd) > KD_OFF * max(kd, MIN_KD) + fit.doubt * kd / kp
    ):
        text = f"tau_est of {name} shows kd {fit.kd:.3g}, meta.json claims {kd:.3g}"
        yield Fault(name="wrong_gains", text=text)
    if fit.feedforward_seen > SEEN_TORQUE and fit.feedforward < -0.5:
        yield Fault(name="flipped_sign", text=f"tau_est of {name} falls where tau_ff grows: a sign is flipped")
