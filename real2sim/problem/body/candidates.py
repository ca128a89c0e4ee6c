"""What may be otherwise than claimed about a robot on the ground, in coordinates that are 0 where nothing is."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from saltus.arrays import Floats
from saltus.effects.body import LEAST_TURNING_M, NOMINAL_CONTACT_TIME_CONSTANT_S, NOMINAL_FRICTION, claimed_body
from saltus.effects.torque_saturation import TorqueSaturation
from saltus.errors import RecordingError
from saltus.real2sim.problem.body.replay import Rig
from saltus.real2sim.problem.joints.candidates import knee_and_plateau
from saltus.real2sim.problem.problem import Candidate, Coordinates, Unknown

SMALLEST_TIME_CONSTANT_S = 0.004  # the engine takes no less than two time steps
LARGEST_TIME_CONSTANT_S = 0.05
LEAST_SOFTER = 3.0
"""A ground of twice the claimed time constant is within bounds, however soft that is."""
FRICTION_RANGE = (0.1, 1.6)
SECANT = 4.0
"""Searches step by a quarter of a scale; a scale of four times a step makes them take the whole step."""
LARGEST_CREEP = 1.2
"""Half of the way, and some, between the ratios of impedances that engines have by default, 1 and 10, in logarithms:
which of them is nearer has been found before."""
LARGEST_GIVE = 1.5
"""Likewise for impedances, of 0.95 and 0.99."""
CALF = 2
CORNERS_NM = (6.0, 12.0, 18.0)
"""Torque at the calf beyond which some is lost: below what the paper's dynamometer saw first (8 Nm), to a jump's."""


@dataclass(frozen=True, kw_only=True)
class Claims:
    """What a log claims of body and ground."""

    payload_kg: float = 0.0
    friction: float = NOMINAL_FRICTION
    contact_time_constant: float = NOMINAL_CONTACT_TIME_CONSTANT_S
    payload_position: tuple[float, ...] | None = None
    """Of what may be on top of the trunk [m], base frame; None for where the simulator has it."""
    motor_strength: float = 1.0
    """Delivered over commanded torque."""

    @classmethod
    def of(cls, meta: dict[str, Any]) -> "Claims":
        """Reads `meta.json`; what it does not say is as in the simulator.

        Raises:
            RecordingError: a claim that no ground and no robot has.
        """
        ground, position = meta.get("ground") or {}, meta.get("payload_position")
        claims = cls(
            payload_kg=float(meta.get("payload_kg") or 0.0),
            friction=float(ground.get("friction", NOMINAL_FRICTION)),
            contact_time_constant=float(ground.get("contact_time_constant", NOMINAL_CONTACT_TIME_CONSTANT_S)),
            payload_position=None if position is None else tuple(float(value) for value in position),
            motor_strength=float(meta.get("motor_strength") or 1.0),
        )
        is_placed = claims.payload_position is None or len(claims.payload_position) == 3
        if not is_placed or min(claims.friction, claims.contact_time_constant) <= 0.0 or claims.payload_kg < 0.0:
            raise RecordingError(f"meta.json claims a ground or a payload that cannot be: {claims}")
        return claims

    def softness(self, time_constant: float) -> float:
        """The coordinate of a time constant [s]."""
        return (time_constant / self.contact_time_constant) ** 2 - 1.0


def trunk_candidates() -> tuple[Candidate, ...]:
    """What may be otherwise about the mass of the trunk and what it carries."""
    return (
        _one("payload_mass", "trunk", Unknown(name="mass", low=-2.5, high=8.0, scale=0.4)),
        _one("com_offset", "trunk", *(Unknown(name=a, low=-0.1, high=0.1, scale=0.01) for a in "xyz")),
        _one(
            "base_inertia",
            "trunk",
            Unknown(name="excess", low=-0.7, high=2.0, scale=0.8),
            coordinates=Coordinates.less("scale", 1.0),
        ),
    )


def candidates(claims: Claims, slips_at: float, calf_limit: float) -> tuple[Candidate, ...]:
    """The effects that motion of the base can show.

    Args:
        claims: Of the log; effects count from there.
        slips_at: A coefficient of friction at which feet would slip in this log. Above it nothing changes with the
            coefficient, so that only a step as far as this shows in which direction the residuals go.
        calf_limit: Torque to which the parameters of a saturation refer [Nm].
    """
    slip_step = SECANT * (claims.friction - slips_at)
    highest = max(claims.softness(LARGEST_TIME_CONSTANT_S), LEAST_SOFTER)
    lowest = min(claims.softness(SMALLEST_TIME_CONSTANT_S), 0.0)
    return (
        *trunk_candidates(),
        _one(
            "foot_friction",
            "feet",
            Unknown(
                name="less",
                low=min(claims.friction - FRICTION_RANGE[1], 0.0),
                high=max(claims.friction - FRICTION_RANGE[0], 0.0),
                scale=slip_step,
            ),
            coordinates=Coordinates(
                parameters=lambda x: {"coefficient": claims.friction - float(x[0])},
                unknowns=lambda values: (claims.friction - values["coefficient"],),
            ),
        ),
        _one(
            "contact_compliance",
            "feet",
            Unknown(name="softness", low=lowest, high=highest, scale=2.0),
            coordinates=Coordinates(
                parameters=lambda x: {"time_constant": claims.contact_time_constant * float(np.sqrt(1.0 + x[0]))},
                unknowns=lambda values: (claims.softness(values["time_constant"]),),
            ),
        ),
        _one(
            "soft_feet",
            "feet",
            Unknown(name="torsion", low=0.0, high=0.2, scale=0.01),
            Unknown(name="rolling", low=0.0, high=0.1, scale=0.005),
        ),
        _one(
            "torque_gain",
            "joints",
            Unknown(name="excess", low=-0.5, high=0.5, scale=0.02),
            coordinates=Coordinates.less("gain", 1.0),
        ),
        _one("battery_sag", "joints", Unknown(name="loss_at_end", low=-0.1, high=0.6, scale=0.04)),
        _one("command_delay", "joints", Unknown(name="delay", low=0.0, high=0.05, scale=0.004)),
        Candidate(
            effect="torque_saturation",
            where="joints",
            unknowns=(
                Unknown(name="loss", low=0.0, high=0.95, scale=0.2),
                Unknown(name="corner", low=3.0, high=35.0, scale=2.0, is_shape=True),
            ),
            starts=tuple((0.0, corner) for corner in CORNERS_NM),
            coordinates=Coordinates(
                parameters=lambda x: _knee_and_plateau(float(x[0]), float(x[1]), calf_limit),
                unknowns=lambda values: _loss_and_corner(values["knee"], values["plateau"], calf_limit),
            ),
        ),
        _one("viscous_friction", "joints", Unknown(name="coefficient", low=0.0, high=2.0, scale=0.05)),
        _one("coulomb_friction", "joints", Unknown(name="torque", low=0.0, high=4.0, scale=0.1)),
        _one("drive_rate", "joints", Unknown(name="continuous", low=0.0, high=1.0, scale=1.0), is_nuisance=True),
        # of a contact a log claims friction and time constant; engines want more to be said, and a step of time
        _one(
            "contact_solver",
            "feet",
            Unknown(name="creep", low=-LARGEST_CREEP, high=LARGEST_CREEP, scale=0.5),
            Unknown(name="give", low=-LARGEST_GIVE, high=LARGEST_GIVE, scale=0.5),
            Unknown(name="fineness", low=0.0, high=1.0, scale=1.0),
            is_nuisance=True,
        ),
    )


def rig_of(names: tuple[str, ...], claims: Claims, unknowns: Floats) -> Rig:
    """What to simulate; `unknowns` of shape (n, unknowns), `names` those of the problem."""
    value = dict(zip(names, unknowns.T, strict=True))
    n = len(unknowns)
    body = claimed_body(
        (n,),
        friction=claims.friction - value["foot_friction.less"],
        payload_kg=claims.payload_kg + value["payload_mass.mass"],
        com_shift=np.stack([value[f"com_offset.{axis}"] for axis in "xyz"], axis=-1),
        inertia_scale=1.0 + value["base_inertia.excess"],
        contact_time_constant=claims.contact_time_constant * np.sqrt(1.0 + value["contact_compliance.softness"]),
        torsion=LEAST_TURNING_M + value["soft_feet.torsion"],
        rolling=LEAST_TURNING_M + value["soft_feet.rolling"],
    )
    return Rig(
        body=body,
        gain=claims.motor_strength * (1.0 + value["torque_gain.excess"]),
        sag=value["battery_sag.loss_at_end"],
        delay_s=value["command_delay.delay"],
        loss=value["torque_saturation.loss"],
        corner=value["torque_saturation.corner"],
        viscous=value["viscous_friction.coefficient"],
        coulomb=value["coulomb_friction.torque"],
        continuous=value["drive_rate.continuous"],
        creep=value["contact_solver.creep"],
        give=value["contact_solver.give"],
    )


def on_top_of(saturation: TorqueSaturation, candidate: Candidate, limit: float) -> Candidate:
    """The candidate of a saturation that adds to one of the profile; it states what both together are at the calf."""

    def parameters(x: Floats) -> dict[str, float]:
        def taken(torque: Floats) -> Floats:
            known = torque - saturation.delivered(np.tile(torque[:, None], 12))[:, CALF]
            return np.asarray(known + x[0] * np.maximum(torque - x[1], 0.0))

        return knee_and_plateau(taken, limit)

    return replace(candidate, coordinates=Coordinates(parameters=parameters, unknowns=lambda _: candidate.starts[0]))


def _knee_and_plateau(loss: float, corner: float, limit: float) -> dict[str, float]:
    """At the calf; a loss of at most 5 % per Nm never takes 5 % of all, and has its knee at the limit."""
    knee = loss * corner / (loss - 0.05) if loss > 0.05 else limit
    plateau = limit - loss * max(limit - corner, 0.0)
    return {"knee": min(knee, limit), "plateau": plateau}


def _loss_and_corner(knee: float, plateau: float, limit: float) -> tuple[float, float]:
    """The inverse of `_knee_and_plateau`."""
    loss = (limit - plateau - 0.05 * knee) / (limit - knee) if knee < limit else 0.0
    return loss, limit - (limit - plateau) / loss if loss > 0.0 else limit


def _one(effect: str, where: str, *unknowns: Unknown, **more: Any) -> Candidate:
    return Candidate(effect=effect, where=where, unknowns=unknowns, **more)
