"""The experiments that can be run, and what each of them makes visible."""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import chain as joined
from pathlib import Path
from typing import Literal

from saltus.constants import PHYSICS_DT
from saltus.errors import check_known
from saltus.real2sim.experiments import motions
from saltus.real2sim.experiments.motions import ExperimentSection, repeat_motion
from saltus.real2sim.experiments.safety import ExperimentLimits
from saltus.robots.robot import Robot
from saltus.terrain import flat, level
from saltus.terrain.terrain import Terrain

SEPARATIONS = Path(__file__).parent / "separations.json"
"""Measured separations of each experiment: `tools/separations.py` writes it,
`next_experiment` reads it."""
WALL_M = 0.9
"""Height of a step that is a wall: from 1 m it fills the upper half of the image of a camera on a
trunk, 30 degrees nose down."""
STEP_M = 0.15
"""A stair."""
FREE = ExperimentLimits()
HELD = ExperimentLimits(
    tilt_rad=3.2, torque_share=1.1
)  # held any way up; a saturation shows at the limit


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """A motion of a robot, what it shows, and what keeps the robot safe."""

    name: str
    how: str
    """Description of the motion, in a sentence."""
    shows: tuple[str, ...]
    """Effects that become visible, by their names in the schema of run logs."""
    base: Literal["fixed", "free"]
    sections: Callable[[Robot], tuple[ExperimentSection, ...]]
    limits: ExperimentLimits
    held_gains: tuple[float, float] = (30.0, 0.8)
    """kp [Nm/rad] and kd [Nm s/rad] of all joints of a held robot; one that stands has its own for
    standing."""
    terrain: Callable[[], Terrain] = field(default=flat.make)
    camera: bool = False
    payload_kg: float = 0.0
    """Payload that a person puts on the trunk beforehand."""

    def gains(self, robot: Robot) -> tuple[float, float]:
        """Kp [Nm/rad] and kd [Nm s/rad] of all joints."""
        return (
            self.held_gains
            if self.base == "fixed"
            else (robot.gains.stand_kp, robot.gains.stand_kd)
        )

    def duration_s(self, robot: Robot) -> float:
        """Time in motion."""
        return float(sum(len(s.commands.q_des) for s in self.sections(robot)) * PHYSICS_DT)


def _both(*parts: tuple[ExperimentSection, ...]) -> tuple[ExperimentSection, ...]:
    return tuple(joined(*parts))


def _chirps(robot: Robot, highest_hz: float) -> tuple[ExperimentSection, ...]:
    return _both(
        repeat_motion("chirp", 2, motions.sweep(robot, 6.0, 0.2, highest_hz, 0.35)),
        repeat_motion("half chirp", 1, motions.sweep(robot, 6.0, 0.2, highest_hz, 0.17)),
    )


def _tour(robot: Robot) -> tuple[ExperimentSection, ...]:
    """Everything that a held robot can show, each motion twice; the first once more at the end."""
    chirp = repeat_motion("chirp", 3, motions.sweep(robot, 4.0, 0.3, 10.0, 0.35))
    return _both(
        chirp[:2],
        repeat_motion("slow triangle", 2, motions.triangle(robot, 3.0, 0.4, 0.25)),
        repeat_motion("small steps", 2, motions.steps(robot, 2.0, 0.5, 0.2)),
        repeat_motion("large steps", 2, motions.steps(robot, 2.0, 0.5, (0.35, 0.35, 0.55))),
        repeat_motion("hold ladder", 2, motions.hold_ladder(robot, 3.0, 0.5, 3)),
        chirp[2:],
    )


def _heave_and_pitch(robot: Robot) -> tuple[ExperimentSection, ...]:
    return _both(
        repeat_motion("heave chirp", 2, motions.body_chirp(robot, 5.0, 0.3, 5.0, height_m=0.03)),
        repeat_motion("pitch chirp", 2, motions.body_chirp(robot, 8.0, 0.3, 5.0, pitch_rad=0.15)),
    )


def _at(robot: Robot, *ahead_m: float) -> tuple[ExperimentSection, ...]:
    """A robot that is put at several distances from the first edge, twice at each."""
    return tuple(
        ExperimentSection(
            name=f"{x:g} m {i + 1}",
            condition=f"{x:g} m",
            commands=motions.rest(robot, 2.5),
            ahead_m=x,
        )
        for i in range(2)
        for x in ahead_m
    )


def _drops(robot: Robot, *heights_m: float) -> tuple[ExperimentSection, ...]:
    return tuple(
        ExperimentSection(
            name=f"{h:g} m {i + 1}",
            condition=f"drop {h:g} m",
            commands=motions.rest(robot, 1.5),
            ahead_m=1.5,
            drop_m=h,
        )
        for i in range(3)
        for h in heights_m
    )


_FRICTION = ("viscous_friction", "coulomb_friction", "stiction", "backlash")
_TIMING = (
    "command_delay", "actuator_lag", "velocity_filter", "velocity_scale", "armature",
    "viscous_friction", "torque_gain",
)  # fmt: skip
_IMAGE_GEOMETRY = ("camera_pitch", "camera_height", "camera_fov", "depth_scale", "depth_bias")
_IMAGE_EDGES = ("edge_holes", "hole_fill", "range_clip", "depth_noise")

_ALL = (
    Experiment(
        name="joint_tour",
        how="chirps, triangles, steps and holds of all joints of a held robot, each twice",
        shows=(
            *_TIMING[:5], "torque_gain", *_FRICTION, "torque_saturation", "torque_speed_limit",
            "encoder_bias",
            "joint_spring", "battery_sag",
        ),
        base="fixed", held_gains=(30.0, 1.2), sections=_tour, limits=HELD,
    ),
    Experiment(
        name="joint_chirp", how="sines from 0.2 to 10 Hz of all joints of a held robot",
        shows=_TIMING, base="fixed", sections=lambda robot: _chirps(robot, 10.0), limits=HELD,
    ),
    Experiment(
        name="joint_chirp_kp2",
        how="the joint chirp with twice the stiffness: gain and inertia part",
        shows=("torque_gain", "armature", "command_delay", "actuator_lag"),
        base="fixed", held_gains=(60.0, 1.6), sections=lambda robot: _chirps(robot, 12.0),
        limits=HELD,
    ),
    Experiment(
        name="single_sine", how="a sine of 1 Hz of all joints of a held robot",
        shows=_FRICTION[:2], base="fixed",
        sections=lambda robot: repeat_motion("sine", 4, motions.sine(robot, 4.0, 1.0, 0.3)),
        limits=HELD,
    ),
    Experiment(
        name="slow_triangle", how="back and forth at 0.15 and 0.5 rad/s",
        shows=_FRICTION, base="fixed",
        sections=lambda robot: _both(
            repeat_motion("0.15 rad/s", 2, motions.triangle(robot, 6.0, 0.15, 0.2)),
            repeat_motion("0.5 rad/s", 2, motions.triangle(robot, 4.0, 0.5, 0.4)),
        ), limits=HELD,
    ),
    Experiment(
        name="small_steps", how="jumps of the desired angle by 0.1 and 0.4 rad",
        shows=("stiction", "coulomb_friction", "command_delay", "actuator_lag"), base="fixed",
        sections=lambda robot: _both(
            repeat_motion("0.1 rad", 2, motions.steps(robot, 4.0, 0.6, 0.05)),
            repeat_motion("0.4 rad", 2, motions.steps(robot, 4.0, 0.6, 0.2)),
        ), limits=HELD,
    ),
    Experiment(
        name="large_steps",
        how="jumps of the desired angle by 0.8 to 1.6 rad: high torque, high speed",
        shows=("torque_saturation", "torque_speed_limit", "torque_gain"), base="fixed",
        held_gains=(24.0, 1.4),
        sections=lambda robot: _both(
            repeat_motion("0.8 rad", 2, motions.steps(robot, 4.0, 0.6, 0.4)),
            repeat_motion("1.6 rad", 3, motions.steps(robot, 4.0, 0.6, (0.48, 0.48, 0.8))),
        ), limits=HELD,
    ),
    Experiment(
        name="hold_ladder", how="rest at angles up and down the range",
        shows=("encoder_bias", "joint_spring", "stiction", "torque_gain", "encoder_quantisation"),
        base="fixed",
        sections=lambda robot: repeat_motion("hold ladder", 3, motions.hold_ladder(robot, 6.0, 0.6,
        6)), limits=HELD,
    ),
    Experiment(
        name="torque_ladder", how="pulses of feed-forward torque of rising size",
        shows=("torque_saturation", "feedforward_delay", "torque_gain"), base="fixed",
        held_gains=(24.0, 1.4),
        sections=lambda robot: repeat_motion("pulses", 3,
            motions.torque_ladder(robot, 7.0, (20.0, 20.0, 30.0), 5, 0.010)),
        limits=HELD,
    ),
    Experiment(
        name="heave_and_pitch", how="heave and pitch of the body from 0.3 to 5 Hz before a step",
        shows=("camera_latency", "temporal_smear", "frame_drop", "imu_latency", "foot_friction"),
        base="free",
        sections=_heave_and_pitch, limits=FREE,
        terrain=lambda: level.make("step", height_m=STEP_M), camera=True,
    ),
    Experiment(
        name="pitch_rocking", how="the body rocks in pitch at 1 and 2 Hz before a step",
        shows=("camera_latency", "imu_latency", "com_offset"), base="free",
        sections=lambda robot: _both(
            repeat_motion("1 Hz", 2, motions.body_sine(robot, 4.0, 1.0, pitch_rad=0.1)),
            repeat_motion("2 Hz", 2, motions.body_sine(robot, 4.0, 2.0, pitch_rad=0.06)),
        ), limits=FREE, terrain=lambda: level.make("step", height_m=STEP_M), camera=True,
    ),
    Experiment(
        name="heave_sine", how="one sine of body height, 1 Hz", shows=("camera_latency",),
        base="free",
        sections=lambda robot: repeat_motion("heave", 3, motions.body_sine(robot, 5.0, 1.0, 0.03)),
        limits=FREE, camera=True,
    ),
    Experiment(
        name="height_step", how="the robot stands 0.4, 0.6 and 0.8 m before a stair",
        shows=(*_IMAGE_GEOMETRY, *_IMAGE_EDGES), base="free",
        sections=lambda robot: _at(robot, 0.4, 0.6, 0.8), limits=FREE,
        terrain=lambda: level.make("step", height_m=STEP_M), camera=True,
    ),
    Experiment(
        name="wall_two_ranges", how="the robot stands 0.7 and 1.4 m before a wall",
        shows=(*_IMAGE_GEOMETRY, "depth_noise"), base="free",
        sections=lambda robot: _at(robot, 0.7, 1.4), limits=FREE,
        terrain=lambda: level.make("step", height_m=WALL_M), camera=True,
    ),
    Experiment(
        name="squat", how="the body goes up and down at 0.5 and 2 Hz",
        shows=("payload_mass", "com_offset", "torque_gain"), base="free",
        sections=lambda robot: _both(
            repeat_motion("stand", 2, motions.rest(robot, 2.0)),
            repeat_motion("0.5 Hz", 2, motions.body_sine(robot, 4.0, 0.5, 0.04)),
            repeat_motion("2 Hz", 2, motions.body_sine(robot, 4.0, 2.0, 0.02)),
        ), limits=FREE,
    ),
    Experiment(
        name="stand_with_payload",
        how="the squat with a known mass of 2 kg on the trunk: mass and gain part",
        shows=("payload_mass", "torque_gain"), base="free",
        sections=lambda robot: _both(
            repeat_motion("stand", 2, motions.rest(robot, 2.0)),
            repeat_motion("0.5 Hz", 2, motions.body_sine(robot, 4.0, 0.5, 0.04)),
        ), limits=FREE, payload_kg=2.0,
    ),
    Experiment(
        name="drop", how="the robot is let fall from 5 and 10 cm onto its feet",
        shows=("contact_compliance", "base_inertia", "payload_mass"), base="free",
        sections=lambda robot: _drops(robot, 0.05, 0.10), limits=FREE,
    ),
)  # fmt: skip

EXPERIMENTS: dict[str, Experiment] = {experiment.name: experiment for experiment in _ALL}


def experiment_named(name: str) -> Experiment:
    """An experiment of the menu; for a name that is none, `ConfigError` names the nearest."""
    check_known("no experiment", name, EXPERIMENTS)
    return EXPERIMENTS[name]
