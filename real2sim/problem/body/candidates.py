"""Candidates for what may differ from the claims about a robot on the ground.

Coordinates are 0 where nothing does.
"""

from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats
from saltus.effects.body import (
    LEAST_TURNING_M,
    NOMINAL_CONTACT_TIME_CONSTANT_S,
    NOMINAL_FRICTION,
    ContactCompliance,
    FootFriction,
    claimed_body,
)
from saltus.effects.motors import LOSS_AT_KNEE, TorqueSaturation
from saltus.real2sim.problem.body.replay import BodySimulation
from saltus.real2sim.problem.joints.candidates import saturation_beside
from saltus.real2sim.problem.problem import (
    Candidate,
    Unknown,
    UnknownCoordinates,
    make_candidate,
    parameter_unknown,
)
from saltus.recordings.run_log import RunLog

SMALLEST_TIME_CONSTANT_S, LARGEST_TIME_CONSTANT_S = ContactCompliance.sought("time_constant")
LEAST_SOFTER = 3.0
"""A ground of twice the claimed time constant is within bounds, however soft that is."""
FRICTION_RANGE = FootFriction.sought("coefficient")
SECANT = 4.0
"""Searches step by a quarter of a scale; a scale of four times a step makes them take the whole
step."""
LARGEST_CREEP = 1.2
"""Half of the way, and some, between the ratios of impedances that engines have by default, 1 and
10, in logarithms: which of them is nearer has been found before."""
CALF = 2
CORNERS_NM = (6.0, 12.0, 18.0)
"""Torque at the calf beyond which some is lost: below what the paper's dynamometer saw first (8
Nm), to a jump's."""


@dataclass(frozen=True, kw_only=True)
class BodyClaims:
    """Claims of a log about body and ground."""

    payload_kg: float = 0.0
    friction: float = NOMINAL_FRICTION
    contact_time_constant: float = NOMINAL_CONTACT_TIME_CONSTANT_S
    payload_position: tuple[float, ...] | None = None
    """Place of what may be on top of the trunk [m], base frame; None for where the simulator has
    it."""
    motor_strength: float = 1.0
    """Delivered over commanded torque."""

    @classmethod
    def of(cls, log: RunLog) -> "BodyClaims":
        """Reads what a log claims; what it does not say is as in the simulator."""
        ground, position = log.meta.get("ground") or {}, log.meta.get("payload_position")
        return cls(
            payload_kg=float(log.meta.get("payload_kg") or 0.0),
            friction=float(ground.get("friction", NOMINAL_FRICTION)),
            contact_time_constant=float(
                ground.get("contact_time_constant", NOMINAL_CONTACT_TIME_CONSTANT_S)
            ),
            payload_position=None
            if position is None
            else tuple(float(value) for value in position),
            motor_strength=float(log.meta.get("motor_strength") or 1.0),
        )

    def softness(self, time_constant: float) -> float:
        """The coordinate of a time constant [s]."""
        return (time_constant / self.contact_time_constant) ** 2 - 1.0


def trunk_candidates() -> tuple[Candidate, ...]:
    """Candidates for the mass of the trunk and what it carries."""
    return (
        make_candidate("payload_mass", parameter_unknown("mass", 0.4), where="trunk"),
        make_candidate(
            "com_offset", *(parameter_unknown(axis, 0.01) for axis in "xyz"), where="trunk"
        ),
        make_candidate("base_inertia", parameter_unknown("scale", 0.8), where="trunk"),
    )


def body_candidates(
    claims: BodyClaims, slips_at: float, calf_limit: float
) -> tuple[Candidate, ...]:
    """The effects that motion of the base can show.

    Args:
        claims: Of the log; effects count from there.
        slips_at: A coefficient of friction at which feet would slip in this log. Above it nothing
            changes with the coefficient, so that only a step as far as this shows in which
            direction the residuals go.
        calf_limit: Torque to which the parameters of a saturation refer [Nm].
    """
    slip_step = SECANT * (claims.friction - slips_at)
    highest = max(claims.softness(LARGEST_TIME_CONSTANT_S), LEAST_SOFTER)
    lowest = min(claims.softness(SMALLEST_TIME_CONSTANT_S), 0.0)
    return (
        *trunk_candidates(),
        make_candidate(
            "foot_friction",
            Unknown(
                "less",
                min(claims.friction - FRICTION_RANGE[1], 0.0),
                max(claims.friction - FRICTION_RANGE[0], 0.0),
                slip_step,
            ),
            where="feet",
            coordinates=UnknownCoordinates(
                parameters=lambda x: {"coefficient": claims.friction - float(x[0])},
                unknowns=lambda values: (claims.friction - values["coefficient"],),
            ),
        ),
        make_candidate(
            "contact_compliance",
            Unknown("softness", lowest, highest, 2.0),
            where="feet",
            coordinates=UnknownCoordinates(
                parameters=lambda x: {
                    "time_constant": claims.contact_time_constant * float(np.sqrt(1.0 + x[0]))
                },
                unknowns=lambda values: (claims.softness(values["time_constant"]),),
            ),
        ),
        make_candidate(
            "soft_feet",
            parameter_unknown("torsion", 0.01),
            parameter_unknown("rolling", 0.005),
            where="feet",
        ),
        make_candidate("torque_gain", parameter_unknown("gain", 0.02), where="joints"),
        make_candidate("battery_sag", parameter_unknown("loss_at_end", 0.04), where="joints"),
        make_candidate("command_delay", parameter_unknown("delay", 0.004), where="joints"),
        make_candidate(
            "torque_saturation",
            Unknown("loss", 0.0, 0.95, 0.2),
            Unknown("corner", 3.0, 35.0, 2.0, is_shape=True),
            where="joints",
            starts=tuple((0.0, corner) for corner in CORNERS_NM),
            coordinates=UnknownCoordinates(
                parameters=lambda x: _knee_and_plateau(float(x[0]), float(x[1]), calf_limit),
                unknowns=lambda _: (0.0, CORNERS_NM[0]),  # what a profile has is held, not fitted
            ),
        ),
        make_candidate("viscous_friction", parameter_unknown("coefficient", 0.05), where="joints"),
        make_candidate("coulomb_friction", parameter_unknown("torque", 0.1), where="joints"),
        make_candidate(
            "drive_rate", Unknown("continuous", 0.0, 1.0, 1.0), is_nuisance=True, where="joints"
        ),
        # Of a contact a log claims friction and time constant; engines want more to be said, and a
        # step of time. By how much a contact gives way is no unknown of its own: a ground of twice
        # the time constant gives way as one does whose impedance leaves four times as much
        make_candidate(
            "contact_solver",
            Unknown("creep", -LARGEST_CREEP, LARGEST_CREEP, 0.5),
            Unknown("fineness", 0.0, 1.0, 1.0),
            where="feet",
            is_nuisance=True,
        ),
    )


def rig_of(names: tuple[str, ...], claims: BodyClaims, unknowns: Floats) -> BodySimulation:
    """Rig to simulate; `unknowns` of shape (n, unknowns), `names` those of the problem."""
    value = dict(zip(names, unknowns.T, strict=True))
    n = len(unknowns)
    body = claimed_body(
        (n,),
        friction=claims.friction - value["foot_friction.less"],
        payload_kg=claims.payload_kg + value["payload_mass.mass"],
        com_shift=np.stack([value[f"com_offset.{axis}"] for axis in "xyz"], axis=-1),
        inertia_scale=1.0 + value["base_inertia.scale"],
        contact_time_constant=claims.contact_time_constant
        * np.sqrt(1.0 + value["contact_compliance.softness"]),
        torsion=LEAST_TURNING_M + value["soft_feet.torsion"],
        rolling=LEAST_TURNING_M + value["soft_feet.rolling"],
    )
    return BodySimulation(
        body=body,
        gain=claims.motor_strength * (1.0 + value["torque_gain.gain"]),
        sag=value["battery_sag.loss_at_end"],
        delay_s=value["command_delay.delay"],
        loss=value["torque_saturation.loss"],
        corner=value["torque_saturation.corner"],
        viscous=value["viscous_friction.coefficient"],
        coulomb=value["coulomb_friction.torque"],
        continuous=value["drive_rate.continuous"],
        creep=value["contact_solver.creep"],
    )


def on_top_of(saturation: TorqueSaturation, candidate: Candidate, limit: float) -> Candidate:
    """The candidate of a saturation that adds to one of the profile.

    It states what both together are at the calf.
    """

    def known(torque: Floats) -> Floats:
        return np.asarray(torque - saturation.delivered(np.tile(torque[:, None], 12))[:, CALF])

    return saturation_beside(
        candidate,
        known,
        lambda torque, loss, corner: loss * np.maximum(torque - corner, 0.0),
        limit,
    )


def _knee_and_plateau(loss: float, corner: float, limit: float) -> dict[str, float]:
    """At the calf.

    A loss of at most 5 % per Nm never takes 5 % of all, and has its knee at the limit.
    """
    knee = loss * corner / (loss - LOSS_AT_KNEE) if loss > LOSS_AT_KNEE else limit
    plateau = limit - loss * max(limit - corner, 0.0)
    return {"knee": min(knee, limit), "plateau": plateau}
