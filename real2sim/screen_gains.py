"""Compares the gains that a log claims with those that the drive's own torque shows."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from real2sim.fault import Fault
from saltus.run_log import JointTable, RunLog

Floats = NDArray[np.float64]

MAX_DELAY_S = 0.04  # of a command packet: the largest that is looked for, and more
DELAYS = 21
ROWS = 6000  # enough for three numbers
FF_DELAYS_S = (0.0, 0.002, 0.005, 0.01, 0.015, 0.02, 0.025)  # of the feed-forward torque behind the packet
SEEN_ERROR = 0.02  # rad RMS: a noise of 2 mrad makes kp 1 % too small
SEEN_RATE = 0.5  # rad/s RMS: a noise of 0.05 rad/s makes kd 1 % too small
SEEN_TORQUE = 0.5  # Nm RMS
KP_OFF, KD_OFF = 0.12, 0.3  # of the claim; the drive computes both exactly, kd suffers from held rows
EXPLAINS = 0.8  # share of the torque's variance, below which kp and kd mean nothing
SENSELESS = 0.4  # share below which the torque belongs to other columns


def gain_faults(log: RunLog) -> list[Fault]:
    """Faults of kp, kd and of the signs of torques, from `tau_est`; none without it."""
    if log.joints.tau_est is None:
        return []
    claims = [np.broadcast_to(np.asarray(log.meta[key], float), (len(log.meta["joints"]),)) for key in ("kp", "kd")]
    return [
        fault
        for joint, name in enumerate(log.meta["joints"])
        for fault in _faults(name, _Fit(log.joints, joint), float(claims[0][joint]), float(claims[1][joint]))
    ]


class _Fit:
    """The torque that a drive believes, regressed on the errors it sees, at the delay that explains most."""

    def __init__(self, joints: JointTable, joint: int) -> None:
        assert joints.tau_est is not None  # noqa: S101 - the caller checked
        time_s = joints.time_s
        step = max(1, len(time_s) // ROWS)
        self._rows = slice(None, None, step)
        torque = joints.tau_est[self._rows, joint]
        q = joints.q[:, joint]
        dq = np.gradient(q, time_s) if joints.dq is None else joints.dq[:, joint]
        fits = [self._regress(joints, joint, delay, q, dq, torque) for delay in np.linspace(0, MAX_DELAY_S, DELAYS)]
        self.explained, (self.kp, self.kd, self.feedforward), self.error, self.rate = max(fits, key=lambda fit: fit[0])
        self.torque = float(np.std(torque))
        self.feedforward_seen = 0.0 if joints.tau_ff is None else float(np.std(joints.tau_ff[:, joint]))

    def _regress(
        self, joints: JointTable, joint: int, delay: float, q: Floats, dq: Floats, torque: Floats
    ) -> tuple[float, tuple[float, float, float], float, float]:
        """Explained share, (kp, kd, weight of the feed-forward), RMS of both errors."""
        now = joints.time_s[self._rows]
        error = _held(joints.time_s, joints.q_des[:, joint], now - delay) - q[self._rows]
        rate = -dq[self._rows]
        if joints.dq_des is not None:
            rate = rate + _held(joints.time_s, joints.dq_des[:, joint], now - delay)
        columns = [error, rate, np.ones_like(error)]
        if joints.tau_ff is not None and np.std(joints.tau_ff[:, joint]) > 0:
            columns += [_held(joints.time_s, joints.tau_ff[:, joint], now - delay - d) for d in FF_DELAYS_S]
        matrix = np.column_stack(columns)
        solution = np.linalg.lstsq(matrix, torque, rcond=1e-9)[0]
        left = torque - matrix @ solution
        explained = 1 - float(np.var(left)) / max(float(np.var(torque)), 1e-12)
        gains = float(solution[0]), float(solution[1]), float(solution[3:].sum())
        return explained, gains, float(np.std(error)), float(np.std(rate))


def _held(time_s: Floats, values: Floats, when_s: Floats) -> Floats:
    """The command in force at a time."""
    return values[np.clip(np.searchsorted(time_s, when_s, side="right") - 1, 0, len(values) - 1)]


def _faults(name: str, fit: _Fit, kp: float, kd: float) -> Iterator[Fault]:
    if fit.torque < SEEN_TORQUE:
        return
    if fit.explained < SENSELESS:
        text = f"q, q_des and gains explain {fit.explained:.0%} of tau_est of {name}: the columns are not of one joint"
        yield Fault(name="torque_unexplained", text=text)
        return
    if fit.explained < EXPLAINS or fit.error < SEEN_ERROR:
        return
    if fit.kp < 0:
        text = f"tau_est of {name} pushes away from q_des (kp {fit.kp:.3g}, claimed {kp:.3g}): a sign is flipped"
        yield Fault(name="flipped_sign", text=text)
        return
    if abs(fit.kp - kp) > KP_OFF * kp:
        text = f"tau_est of {name} shows kp {fit.kp:.3g}, meta.json claims {kp:.3g}"
        yield Fault(name="wrong_gains", text=text)
    elif fit.rate > SEEN_RATE and abs(fit.kd - kd) > KD_OFF * max(kd, 0.1):
        text = f"tau_est of {name} shows kd {fit.kd:.3g}, meta.json claims {kd:.3g}"
        yield Fault(name="wrong_gains", text=text)
    if fit.feedforward_seen > SEEN_TORQUE and fit.feedforward < -0.5:
        yield Fault(name="flipped_sign", text=f"tau_est of {name} falls where tau_ff grows: a sign is flipped")
