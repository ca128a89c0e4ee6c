"""Tracking of the body's pitch rate with feed-forward alone and with velocity feedback,
as in the paper's figure.

A Go1 with the drives of the profile "go1" bounds on flat ground in MuJoCo on the estimated state.
The reference pitch rate is a sine of the gait's phase, nose up in the middle of the front stance,
nose down in the middle of the rear stance. Errors count where a leg that is to stand does touch the
ground: nothing can track in the air. Plans come 100 times a second, as a policy's do.

    OMP_NUM_THREADS=1 saltus bench feedback -- --picture feedback.png
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks._command import progress
from benchmarks._pictures import Pictured, save, subplots
from saltus.arrays import Floats, Reals
from saltus.config import TerrainConfig
from saltus.constants import POLICY_DT
from saltus.effects.profile import SHIPPED
from saltus.grid import LINE
from saltus.loop.body import Body
from saltus.loop.planner import observe
from saltus.named_setup import named_setups
from saltus.plan import Plan
from saltus.robots.legs import LegKinematics
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.terrain.curriculum import make_terrain
from saltus.trial import Trial
from saltus.wire.messages import ControllerMode

AMPLITUDE = 4.0  # [rad/s], two thirds of what motion policies may ask for
VELOCITY_X = 0.8  # [m/s], the paper's speed on stairs
VELOCITY_Z = 0.4  # [m/s], keeps the base up at all three frequencies
LIFT_M = 0.1
FRONT_STANCE_PHASE = (
    0.15  # middle of the front stance in cycles; the rear stance follows 0.45 later
)
STAND_S = 1.0
FREQUENCIES_HZ = (1.5, 2.0, 3.0)
SHOWN_HZ, SHOWN_S = 2.0, (2.0, 4.0)


@dataclass(frozen=True, kw_only=True)
class Benchmark(Pictured):
    seconds: float = 3.0
    """Seconds of running, after a second of standing."""

    def measure(self) -> dict[str, Any]:
        """RMS of the error [rad/s] at each stepping frequency [Hz]."""
        forward, both = (run(kd, self.seconds) for kd in progress((0.0, 1.0)))
        if self.picture is not None:
            shown = FREQUENCIES_HZ.index(SHOWN_HZ)
            draw(forward[shown], both[shown], self.picture)
        return {
            "rms_rad_s": {
                str(frequency_hz): {"feedforward": round(one.rms, 2), "feedback": round(two.rms, 2)}
                for frequency_hz, one, two in zip(FREQUENCIES_HZ, forward, both, strict=True)
            }
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class StepTrace:
    """One run; a row each 10 ms; arrays of shape (steps,)."""

    time_s: Reals
    reference: Floats
    """Pitch rate [rad/s]."""
    measured: Floats
    touching: NDArray[np.bool_]

    @property
    def rms(self) -> float:
        """Rms of the error on the ground, after the first stand [rad/s]."""
        error = (self.reference - self.measured)[self.touching & (self.time_s > STAND_S)]
        return float(np.sqrt(np.mean(error**2)))


def make_plan(phase: Floats) -> Plan:
    """Bounding with a pitch rate that follows the phase, at each frequency."""
    one = np.ones(len(FREQUENCIES_HZ))
    residual = one[:, None] * np.array([0.0, 0.0, LIFT_M])
    return Plan(
        stepping_frequency_hz=np.array(FREQUENCIES_HZ),
        velocity_x=VELOCITY_X * one,
        velocity_z=VELOCITY_Z * one,
        pitch_rate=-AMPLITUDE * np.cos(2.0 * np.pi * (phase - FRONT_STANCE_PHASE)),
        foot_residual_front=residual,
        foot_residual_rear=residual,
    )


def run(kd: float, seconds: float) -> list[StepTrace]:
    """Bounds at each frequency with the given gain of the feedback; 0 is feed-forward alone."""
    robot = load_robot(DEFAULT_ROBOT)
    robot = replace(robot, gains=replace(robot.gains, stance_kd=kd))
    count, flat = len(FREQUENCIES_HZ), make_terrain(TerrainConfig(terrain="flat"))
    body = Body(named_setups(robot, LINE, "ideal", SHIPPED, [flat] * count, [Trial()] * count))
    legs, rows = LegKinematics(robot), []
    for step in range(round((STAND_S + seconds) / POLICY_DT)):
        states, plan = body.states(step), make_plan(body.state.law.gait.phase)
        touching = (states.leg_contact & (body.truth.foot_force > 1.0)).any(axis=-1)
        rows.append((plan.pitch_rate, observe(states, legs).angular_velocity[:, 1], touching))
        is_standing = step * POLICY_DT < STAND_S
        body.step(plan, ControllerMode.STAND if is_standing else ControllerMode.RUN)
    time_s = np.arange(len(rows)) * POLICY_DT
    return [
        StepTrace(time_s=time_s, reference=reference, measured=measured, touching=touching > 0.0)
        for reference, measured, touching in np.array(rows).transpose(2, 1, 0)
    ]


def draw(forward: StepTrace, both: StepTrace, out: Path) -> None:
    """Two panels, one for each controller; stretches without ground contact are shaded."""
    figure, axes = subplots(2, 1, figsize=(8.0, 5.0), sharex=True, sharey=True)
    for axis, trace, name in (
        (axes[0], forward, "Feed-forward only"),
        (axes[1], both, "Feed-forward and feedback"),
    ):
        axis.fill_between(
            trace.time_s,
            0,
            1,
            where=~trace.touching,
            transform=axis.get_xaxis_transform(),
            color="0.92",
            step="post",
        )
        axis.plot(trace.time_s, trace.reference, "--", color="0.3", label="reference")
        axis.plot(
            trace.time_s,
            trace.measured,
            color="tab:orange" if trace is forward else "tab:blue",
            label="measured",
        )
        axis.set_title(
            f"{name}: RMS error {trace.rms:.2f} rad/s on the ground", loc="left", fontsize=10
        )
        axis.set_ylabel("pitch rate [rad/s]")
        axis.legend(loc="upper right", ncols=2, fontsize=8)
    axes[1].set_xlabel("time [s]; grey: no leg in stance touches the ground")
    axes[1].set_xlim(*SHOWN_S)
    save(figure, out)
