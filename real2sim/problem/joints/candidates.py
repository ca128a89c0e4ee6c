"""Effects of joints as unknowns: coordinates in which 0 is absent,
and their way to and from physical parameters.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from saltus.arrays import Floats
from saltus.effects.joint_loads import JointSpring
from saltus.effects.motors import LOSS_AT_KNEE
from saltus.real2sim.problem.joints.drives import JointDrives
from saltus.real2sim.problem.problem import (
    Candidate,
    Unknown,
    UnknownCoordinates,
    parameter_unknown,
    unknowns_of,
)

NO_KNEE = 200.0  # [Nm] stated where the loss never reaches that share
HALF_FREE = 0.02
"""Give of what holds a base [rad/Nm] at which its unknown is a half."""
EffectTorque = Callable[..., Floats]
"""A law of saturation gives the torque that is lost [Nm], for a commanded torque >= 0 [Nm] and the
unknowns of the saturation."""
JITTERS = 0.975
"""Share of its gap that a delay closes whose packets come with a jitter of a tenth of it, and some
late."""
LEAST_CLOSED = 0.9
"""True effects alone close 0.95 or more of what is not chance; a motor that warms up was imitated
to 0.76 to 0.89 by a lower gain or an emptying battery."""
LOOP_RATE = "drive_rate"
"""Nuisance: how much faster than claimed the drive closes its loop."""


WEIGHT = Unknown("weight", 0.0, 1.0, 0.2, stated=1.0)
"""How much of an effect there is that is there or not: a fit may come from absence to presence by
degrees."""
BEND = Unknown("bend", 0.0, 5e-3, 2e-4, is_shape=True, is_told=False)
"""How far bristles of dry friction bend before they give way [rad]; the plant's are rigid."""


@dataclass(frozen=True, kw_only=True)
class LogRange:
    """How far the motion of a log goes at one place of all legs: angles, speeds, torques."""

    speed: float
    """Largest [rad/s]."""
    slowest: float
    """Largest [rad/s] of the leg whose joint is slowest: a speed limit may be that of one leg."""
    torque: float
    """Largest commanded [Nm]."""
    middle: float
    """Mean angle [rad]."""
    side: float
    """Side of the claimed limit that the log comes nearest to: +1 at large angles, -1 at small."""
    end: float
    """Angle that is nearest to that limit [rad]."""
    to_limit: float
    """From there to the limit [rad]."""
    steps: tuple[float, ...]
    """Steps of an encoder that the angles suggest [rad]."""


StartValues = tuple[tuple[float, ...], ...]
SLOWER = 0.8
"""Ratio of the slowest leg's largest speed to that of all, below which it is a start of its own:
legs that are told the same differ by less, and starts cost time."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LegLogRanges:
    """Ranges that a log covers at all places of a leg, as `LogRange` has it; shapes (joints, 1)."""

    middle: Floats
    side: Floats
    end: Floats

    @classmethod
    def of(cls, reach: Sequence[LogRange]) -> "LegLogRanges":
        """The reach at all places of a leg, from the base outwards."""
        return cls(
            **{
                name: np.array([getattr(r, name) for r in reach])[:, None]
                for name in ("middle", "side", "end")
            }
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class JointKind(Candidate):
    """A candidate at any joint, and what of it depends on the place of a log."""

    starts_at: Callable[[StartValues, LogRange], StartValues] = lambda starts, _: starts
    coordinates_at: Callable[[LogRange], UnknownCoordinates] | None = None
    drive: Callable[[tuple[Floats, ...], LegLogRanges], tuple[Floats, ...]] = lambda unknowns, _: (
        unknowns
    )
    """Function from the unknowns of a candidate to what `JointDrives` takes, arrays of shape
    (branches, joints, sets)."""

    def at(self, place: str, reach: LogRange) -> Candidate:
        """The candidate at a place of a leg."""
        way = self.coordinates if self.coordinates_at is None else self.coordinates_at(reach)
        return replace(
            self, where=place, starts=self.starts_at(self.starts, reach), coordinates=way
        )


def _kind(
    effect: str, *unknowns: Unknown | Callable[[str], Unknown], where: str = "", **more: Any
) -> JointKind:
    own = unknowns_of(effect, unknowns)
    return JointKind(
        effect=effect, where=where, unknowns=own, **{"least_closed": LEAST_CLOSED} | more
    )


def _speeds(reach: LogRange) -> tuple[float, ...]:
    """Speeds near which a limit of all legs, or of the slowest, may lie [rad/s]."""
    is_slower = reach.slowest < SLOWER * reach.speed
    return (reach.speed, reach.slowest) if is_slower else (reach.speed,)


def _spring(reach: LogRange) -> UnknownCoordinates:
    """A spring by its pull at the mean angle, which tells nothing of its stiffness."""
    return UnknownCoordinates(
        parameters=lambda x: {
            "torque": float(x[0] + x[1] * reach.middle),
            "stiffness": float(x[1]),
        },
        unknowns=lambda values: (
            values["torque"] - values["stiffness"] * reach.middle,
            values["stiffness"],
        ),
    )


def _stop(reach: LogRange) -> UnknownCoordinates:
    """A stop by how far it reaches into the range of the log."""
    name = "upper" if reach.side > 0.0 else "lower"
    return UnknownCoordinates(
        parameters=lambda x: {"stiffness": float(x[0]), name: reach.end - reach.side * float(x[1])},
        unknowns=lambda values: (values["stiffness"], reach.side * (reach.end - values[name])),
    )


# Bounds of parameters are those of the effects; scales are the smallest changes that matter on
# hardware (magnitudes published for robots of this class). Resolutions are what fits find in logs
# without any effect that another simulator made, whose velocities are half an integration step,
# 0.06 ms, late.
KINDS = (
    # packets come with jitter, of which a delay says nothing
    _kind(
        "command_delay",
        parameter_unknown("delay", 1e-3),
        starts=((0.004,), (0.012,)),
        resolution=5e-5,
        closable_share=JITTERS,
        leaves_chance=True,
    ),
    _kind(
        "feedforward_delay",
        parameter_unknown("delay", 1e-3),
        starts=((0.004,), (0.012,)),
        resolution=4e-4,
        closable_share=JITTERS,
        leaves_chance=True,
    ),
    _kind(
        "actuator_lag",
        parameter_unknown("time_constant", 1e-3),
        starts=((0.004,), (0.012,)),
        resolution=7e-5,
    ),
    _kind(  # starts are shares of the largest speeds of the log
        "torque_speed_limit",
        WEIGHT,
        parameter_unknown("corner", 1.0, is_shape=True),
        Unknown("span", 0.3, 60.0, 1.0, is_shape=True),
        starts=((1.0, 0.0, 1.3), (1.0, 0.3, 0.5), (1.0, 0.5, 0.2), (1.0, 0.6, 0.7)),
        starts_at=lambda starts, reach: tuple(
            (weight, a * speed, b * speed) for speed in _speeds(reach) for weight, a, b in starts
        ),
        coordinates=UnknownCoordinates(
            parameters=lambda x: {"corner": float(x[1]), "no_load": float(x[1]) + float(x[2])},
            unknowns=lambda values: (1.0, values["corner"], values["no_load"] - values["corner"]),
        ),
    ),
    _kind(  # the corner's starts are shares of the largest torque
        "torque_saturation",
        Unknown("loss", 0.0, 1.0, 0.05),
        Unknown("corner", 1.0, 34.0, 0.5, is_shape=True),
        # Of a softer bend a log shows only how the loss begins, whatever it comes to
        Unknown("rounding", 0.05, 20.0, 0.5, is_shape=True),
        starts=((0.4, 0.2, 1.0), (0.4, 0.4, 1.0), (0.4, 0.6, 1.0), (0.4, 0.8, 1.0)),
        starts_at=lambda starts, reach: tuple(
            (loss, corner * reach.torque, width) for loss, corner, width in starts
        ),
    ),
    _kind("torque_gain", parameter_unknown("gain", 0.01), resolution=4e-3),
    _kind("battery_sag", parameter_unknown("loss_at_end", 0.01), starts=((0.1,),)),
    _kind(
        "viscous_friction",
        parameter_unknown("coefficient", 0.02),
        starts=((0.1,),),
        resolution=2e-3,
    ),
    _kind(
        "coulomb_friction",
        parameter_unknown("torque", 0.04),
        BEND,
        starts=((0.2, 0.0), (0.2, 5e-4)),
        resolution=2e-3,
    ),
    _kind(
        "stiction",
        parameter_unknown("breakaway", 0.1),
        parameter_unknown("stribeck_velocity", 0.02, is_shape=True),
        BEND,
        starts=((0.3, 0.05, 0.0), (0.3, 0.25, 0.0), (0.3, 0.05, 5e-4)),
        # Bristles that bend blunt the peak at standstill: the laws differ by 10 to 20 %
        model_error=0.12,
        closable_share=0.95,
    ),
    _kind(
        "backlash",
        parameter_unknown("width", 2e-3),
        parameter_unknown("motor_side", 0.5, is_shape=True, is_choice=True),
        starts=((0.01, 0.0), (0.01, 1.0)),
        resolution=1e-4,
        # Which tooth a light leg lies on when little torque is asked for is up to chance
        closable_share=0.9,
    ),
    _kind(
        "joint_spring",
        Unknown("pull", *JointSpring.sought("torque"), 0.05),
        parameter_unknown("stiffness", 0.2),
        coordinates_at=_spring,
        drive=lambda x, places: (x[0] + x[1] * places.middle, x[1]),
        # True ones close 0.998; an integral term of the drive, which it imitates, 0.79 to 0.90
        least_closed=0.95,
    ),
    _kind(  # how far the stop reaches into the range of the log
        "end_stop",
        parameter_unknown("stiffness", 10.0),
        Unknown("depth", 0.0, 0.4, 0.005, is_shape=True),
        starts=((300.0, 0.02), (300.0, 0.06), (300.0, 0.15)),
        coordinates_at=_stop,
        drive=lambda x, places: (places.side, places.end - places.side * x[1], x[0]),
    ),
    _kind(  # between a rigid and a free base lies a resonance
        "base_roll",
        WEIGHT,
        Unknown("freedom", 0.0, 0.99, 0.02, is_shape=True),
        parameter_unknown("damping", 0.1, is_shape=True),
        starts=((1.0, 0.1, 0.3), (1.0, 0.5, 0.3), (1.0, 0.9, 0.3)),
        model_error=0.05,
        where="trunk",  # all legs have one base
        drive=lambda x, _: (x[0][:, 0], HALF_FREE * x[1][:, 0] / (1.0 - x[1][:, 0]), x[2][:, 0]),
        coordinates=UnknownCoordinates(
            parameters=lambda x: {
                "give": HALF_FREE * float(x[1] / (1.0 - x[1])),
                "damping": float(x[2]),
            },
            unknowns=lambda values: (
                1.0,
                values["give"] / (HALF_FREE + values["give"]),
                values["damping"],
            ),
        ),
    ),
    _kind("armature", parameter_unknown("added", 5e-4), resolution=7e-5),
    _kind("encoder_bias", parameter_unknown("bias", 2e-3), resolution=4e-3),
    _kind(
        "encoder_quantisation",
        WEIGHT,
        parameter_unknown("step", 1e-6, is_shape=True),
        starts=((1.0, 0.005),),
        starts_at=lambda starts, reach: tuple((1.0, step) for step in reach.steps) or starts,
        closable_share=0.95,
    ),
    _kind(
        "velocity_filter",
        parameter_unknown("time_constant", 1e-3),
        starts=((0.004,), (0.012,)),
        resolution=7e-5,
    ),
    _kind("velocity_scale", parameter_unknown("scale", 0.02)),
    _kind(LOOP_RATE, Unknown("rate", 0.0, 1.0, 0.25), starts=((0.5,),), is_nuisance=True),
)


class JointCandidates:
    """All candidates of the joints, at every place of a leg.

    Args:
        places: Names of the joints of a leg, from the base outwards, e.g. ("hip", "thigh", "calf").
        limit: Torque limits of the joints [Nm], shape (branches, joints).
        reach: What the log shows of each place, in the order of `places`.
        left_out: Effects that the log cannot show.
    """

    def __init__(
        self,
        places: Sequence[str],
        limit: Floats,
        reach: Sequence[LogRange],
        left_out: Sequence[str] = (),
    ) -> None:
        self._places, self._limit = tuple(places), limit
        self._reached = LegLogRanges.of(reach)
        self.columns: dict[tuple[str, int], slice] = {}
        """Where the unknowns of an effect at the joint of a leg stand."""
        listed: list[Candidate] = []
        start = 0
        for kind in (kind for kind in KINDS if kind.effect not in left_out):
            # the loop of a leg's drives has one rate
            own = (
                (kind.where,)
                if kind.where
                else self._places[:1]
                if kind.is_nuisance
                else self._places
            )
            for joint, place in enumerate(own):
                listed.append(kind.at(place, reach[joint]))
                self.columns[kind.effect, joint] = slice(start, start + len(kind.unknowns))
                start += len(kind.unknowns)
        self.listed = tuple(listed)
        self.count = start

    def drives(self, unknowns: Floats, dt_s: float) -> JointDrives:
        """Drives with the effects of sets of unknowns, shape (sets, branches, unknowns)."""
        found = [(kind, self._values(kind, unknowns)) for kind in KINDS]
        told = {
            kind.effect: kind.drive(values, self._reached)
            for kind, values in found
            if values is not None
        }
        own: dict[str, Any] = {
            effect: values[0] if len(values) == 1 else values for effect, values in told.items()
        }
        return JointDrives(count=len(unknowns), dt_s=dt_s, limit=self._limit[..., None], **own)

    def has(self, effects: Sequence[str], unknowns: Floats) -> np.ndarray:
        """Which sets have one of the effects anywhere, shape (sets,)."""
        found = np.zeros(len(unknowns), dtype=bool)
        for (effect, _), columns in self.columns.items():
            if effect in effects:
                found |= np.any(unknowns[:, :, columns.start] != 0.0, axis=1)
        return found

    def _values(self, kind: Candidate, unknowns: Floats) -> tuple[Floats, ...] | None:
        """Each unknown as (branches, joints, sets);
        None where the effect is absent from all sets.
        """
        columns = [self.columns.get((kind.effect, joint)) for joint in range(len(self._places))]
        present = [columns[0] if c is None else c for c in columns if columns[0] is not None]
        if not present or not np.any(unknowns[:, :, [c.start for c in present]]):
            return None
        values = []
        for i, unknown in enumerate(kind.unknowns):
            array = np.ascontiguousarray(
                unknowns[:, :, [c.start + i for c in present]].transpose(1, 2, 0)
            )
            array = np.clip(array, unknown.low, unknown.high) if unknown.is_shape else array
            values.append(np.round(array) if unknown.is_choice else array)
        return tuple(values)


def knee_and_plateau(taken: Callable[[Floats], Floats], limit: float) -> dict[str, float]:
    """Parameters of a saturation that takes `taken` of a commanded torque,
    at a joint with this limit torque [Nm].
    """
    torque = np.linspace(0.0, NO_KNEE, 20001)[1:]
    beyond = taken(torque) >= LOSS_AT_KNEE * torque
    knee = float(torque[np.argmax(beyond)]) if beyond.any() else NO_KNEE
    plateau = limit - float(taken(np.array([limit]))[0])
    return {"knee": knee, "plateau": plateau}


def saturation_beside(
    candidate: Candidate, known: Callable[[Floats], Floats], law: EffectTorque, limit: float
) -> Candidate:
    """The candidate of a saturation whose law adds to a known one.

    It states what both together take of a torque.
    """
    return replace(
        candidate,
        coordinates=UnknownCoordinates(
            parameters=lambda x: knee_and_plateau(
                lambda torque: law(torque, *x) + known(torque), limit
            ),
            unknowns=lambda _: (
                candidate.absent.tolist()
            ),  # what a profile has is assumed, not fitted
        ),
    )
