"""Which effects on body and ground a log cannot show, and why."""

import numpy as np

from saltus.arrays import Floats
from saltus.constants import PHYSICS_DT
from saltus.real2sim.problem.problem import Problem

TYPICAL = {
    "payload_mass.mass": 1.0,
    "com_offset.x": 0.02,
    "base_inertia.scale": 0.2,
    "contact_compliance.softness": 3.0,
    "soft_feet.rolling": 0.01,
    "torque_gain.gain": 0.1,
    "battery_sag.loss_at_end": 0.1,
    "command_delay.delay": 0.005,
    "torque_saturation.loss": 0.4,
    "viscous_friction.coefficient": 0.1,
    "coulomb_friction.torque": 0.3,
}
"""A change of usual size (published ranges of domain randomisation; compliance that doubles the time constant)."""
IN_WORDS = {
    "payload_mass": "1 kg",
    "com_offset": "2 cm",
    "base_inertia": "20 % of the trunk's inertia",
    "foot_friction": "half the coefficient",
    "contact_compliance": "a contact of twice the time constant",
    "soft_feet": "1 cm of friction against rolling",
    "torque_gain": "10 % of torque",
    "battery_sag": "10 % of torque lost by the end",
    "command_delay": "5 ms",
    "torque_saturation": "a loss of 40 % beyond 6 Nm",
    "viscous_friction": "0.1 Nm s/rad",
    "coulomb_friction": "0.3 Nm",
}
LEAST_SIGMA = 6.0
"""Norm of the whitened change by a typical effect below which nobody could name it: its estimate would have a standard
error of a sixth of it, and a search over a dozen effects asks for four."""


def untestable(problem: Problem, friction: float, ratio: Floats, normal: Floats) -> dict[str, str]:
    """Effects that would not be seen, with the reason.

    Args:
        problem: Whose residuals are asked.
        friction: Claimed.
        ratio: Tangential over normal force of feet under load, 0 where there is none, shape (w, steps, 4).
        normal: Normal force [N], same shape.
    """
    found = {}
    for name, sigma in problem.visibility(TYPICAL | {"foot_friction.less": 0.5 * friction}).items():
        effect = name.partition(".")[0]
        if sigma < LEAST_SIGMA:
            because = _because(effect, friction, ratio, normal)
            found[effect] = f"{because}{IN_WORDS[effect]} would move all residuals by {sigma:.1f} sigma"
    return found


def _because(effect: str, friction: float, ratio: Floats, normal: Floats) -> str:
    """The physical reason, where there is one."""
    if effect == "foot_friction":
        return f"no slip: max |Ft|/Fn {float(ratio.max()):.2f} < {friction}; "
    flight_s = PHYSICS_DT * float(np.sum(np.all(normal <= 0.0, axis=-1)))
    if effect == "base_inertia" and flight_s < 0.1:
        return f"{flight_s:.2f} s of flight; "
    lifts = int(np.sum(np.diff((normal > 0.0).astype(np.int8), axis=1) > 0))
    if effect == "contact_compliance" and lifts < 4:
        return f"{lifts} touchdowns of a foot; "
    return ""
