"""Tracking of the body's pitch rate with feed-forward alone and with velocity feedback, as in the paper's figure.

A Go1 with the drives of the profile "go1" bounds on flat ground in MuJoCo on the estimated state.
The reference pitch rate is a sine of the gait's phase, nose up in the middle of the front stance,
nose down in the middle of the rear stance. Errors count where a leg that is to stand does touch the
ground: nothing can track in the air.

    OMP_NUM_THREADS=1 saltus bench feedback -- --picture feedback.png
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks._command import progress
from benchmarks._pictures import Pictured, save, subplots
from saltus.config import TerrainConfig
from saltus.constants import PHYSICS_DT
from saltus.controller.estimator import Estimator
from saltus.controller.gait import standing
from saltus.controller.law import LegController
from saltus.controller.robot.mujoco import MujocoRobot
from saltus.controller.signals import Reference, reference_of
from saltus.depth_camera import load_camera
from saltus.effects.profile import SHIPPED, load_profile
from saltus.grid import LINE
from saltus.plan import Plan
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.setup import Setup
from saltus.states import states_of
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
        errors = {}
        for frequency_hz in progress(FREQUENCIES_HZ):
            forward, both = (run(kd, frequency_hz, self.seconds) for kd in (0.0, 1.0))
            errors[str(frequency_hz)] = {
                "feedforward": round(forward.rms, 2),
                "feedback": round(both.rms, 2),
            }
            if frequency_hz == SHOWN_HZ and self.picture is not None:
                draw(forward, both, self.picture)
        return {"rms_rad_s": errors}


@dataclass(frozen=True, kw_only=True, eq=False)
class TickTrace:
    """One run; arrays of shape (ticks,)."""

    time_s: NDArray[np.float64]
    reference: NDArray[np.float64]
    """Pitch rate [rad/s]."""
    measured: NDArray[np.float64]
    touching: NDArray[np.bool_]

    @property
    def rms(self) -> float:
        """Rms of the error on the ground, after the first stand [rad/s]."""
        error = (self.reference - self.measured)[self.touching & (self.time_s > STAND_S)]
        return float(np.sqrt(np.mean(error**2)))


def make_plan(phase: float, frequency_hz: float) -> Reference:
    """Bounding with a pitch rate that follows the phase."""
    residual = np.array([0.0, 0.0, LIFT_M])
    plan = Plan(
        stepping_frequency_hz=np.asarray(frequency_hz),
        velocity_x=np.asarray(VELOCITY_X),
        velocity_z=np.asarray(VELOCITY_Z),
        pitch_rate=np.asarray(-AMPLITUDE * np.cos(2.0 * np.pi * (phase - FRONT_STANCE_PHASE))),
        foot_residual_front=residual,
        foot_residual_rear=residual,
    )
    return reference_of(plan, np.asarray(0.0))


def run(kd: float, frequency_hz: float, seconds: float) -> TickTrace:
    """Bounds with the given gain of the feedback; 0 is feed-forward alone."""
    model = load_robot(DEFAULT_ROBOT)
    profile = load_profile(SHIPPED, model)
    robot = MujocoRobot(
        Setup(
            robot=model,
            grid=LINE,
            terrain=make_terrain(TerrainConfig(terrain="flat")),
            profile=profile,
            camera=load_camera("ideal"),
            trial=Trial(),
        )
    )
    model = replace(model, gains=replace(model.gains, stance_kd=kd))
    law, estimator = LegController(model), Estimator(model)
    law_state, estimate = law.init((), model.stand_pose), estimator.init((), model.stand_pose)
    gait, rows = standing((), model.stand_pose), []
    for tick in range(round((STAND_S + seconds) / PHYSICS_DT)):
        measured = robot.read().measurement
        estimate = estimator.step(measured, gait.trusted, estimate)
        mode = ControllerMode.STAND if tick * PHYSICS_DT < STAND_S else ControllerMode.RUN
        plan = make_plan(float(law_state.gait.phase), frequency_hz)
        command, law_state, diagnostics = law.step(
            plan, states_of(measured, estimate, gait), law_state, mode
        )
        gait = diagnostics.gait
        touching = bool((gait.contact & (robot.state.foot_force > 1.0)).any())
        reference = diagnostics.angular_velocity_reference[1]
        rows.append((tick * PHYSICS_DT, reference, diagnostics.body.angular_velocity[1], touching))
        robot.write(command)
    time_s, reference, pitch_rate, touching_rows = np.array(rows).T
    return TickTrace(
        time_s=time_s, reference=reference, measured=pitch_rate, touching=touching_rows > 0.0
    )


def draw(forward: TickTrace, both: TickTrace, out: Path) -> None:
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
