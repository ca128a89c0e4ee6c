"""The robot's body and the ground under it, as effects change them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from saltus.arrays import Array

NOMINAL_FRICTION = 0.8
"""Coefficient between soles and ground that the model claims: rubber on concrete, middle of what
trials draw."""
NOMINAL_CONTACT_TIME_CONSTANT_S = 0.005
"""Time constant of the contacts that the model claims: nearly as stiff as a time step of 2 ms
allows (the engine wants two)."""
NOMINAL_TOUCH_IMPEDANCE = 0.95
"""Impedance of the contacts that the model claims, where they begin; the engine's default is
0.9."""
NOMINAL_IMPEDANCE_DEPTH_M = 0.001
"""Depth at which they have reached their full impedance; the engine's default."""
LEAST_TURNING_M = 1e-5
"""Friction against turning and rolling that is there in any case; the engine's least."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyModel:
    """The parts of a robot's model that effects may change; one robot, or a batch.

    Sites "model" and "stand".

    Those of shape (...) but the payload may be one number for all robots of a batch.
    """

    payload_kg: Array
    """Mass on top of the trunk [kg], shape (...); negative where the trunk is lighter than
    claimed."""
    com_shift: Array
    """Added to the trunk's centre of mass [m], base frame, shape (..., 3)."""
    inertia_scale: Array
    """Inertia scale of the trunk about its centre of mass, true over claimed, shape (...)."""
    friction: Array
    """Coefficient of sliding friction between robot and terrain, shape (...)."""
    contact_time_constant: Array
    """Contact time constant of the contacts, which are critically damped [s], shape (...)."""
    touch_impedance: Array
    """Touch impedance of the contacts where they begin: 1 is rigid, shape (...)."""
    impedance_depth: Array
    """Depth at which they have reached their full impedance [m], shape (...)."""
    torsion: Array
    """Coefficient of friction against turning about the normal of a contact [m], shape (...)."""
    rolling: Array
    """Coefficient of friction against rolling [m], shape (...)."""
    roll_give: Array = 0.0
    """By how much the base of a held robot rolls under 1 Nm [rad/Nm], shape (...); 0 is rigid."""
    roll_damping: Array = 0.0
    """Roll damping of that motion [Nm s/rad], shape (...)."""


def claimed_body(
    batch: tuple[int, ...] = (),
    *,
    friction: ArrayLike = NOMINAL_FRICTION,
    payload_kg: ArrayLike = 0.0,
    com_shift: ArrayLike = (0.0, 0.0, 0.0),
    inertia_scale: ArrayLike = 1.0,
    contact_time_constant: ArrayLike = NOMINAL_CONTACT_TIME_CONSTANT_S,
    torsion: ArrayLike = LEAST_TURNING_M,
    rolling: ArrayLike = LEAST_TURNING_M,
) -> BodyModel:
    """The model without effects, or with values given directly; all broadcast.

    Args:
        batch: Leading dimensions.
        friction: Coefficient, to `batch`.
        payload_kg: Mass on top of the trunk [kg], to `batch`.
        com_shift: Added to the trunk's centre of mass [m], base frame, to (*batch, 3).
        inertia_scale: Of the trunk, to `batch`.
        contact_time_constant: Of the contacts [s], to `batch`.
        torsion: Friction against turning on the spot [m], to `batch`.
        rolling: Friction against rolling [m], to `batch`.
    """
    return BodyModel(
        payload_kg=_filled(payload_kg, batch),
        com_shift=_filled(com_shift, (*batch, 3)),
        inertia_scale=_filled(inertia_scale, batch),
        friction=_filled(friction, batch),
        contact_time_constant=_filled(contact_time_constant, batch),
        touch_impedance=_filled(NOMINAL_TOUCH_IMPEDANCE, batch),
        impedance_depth=_filled(NOMINAL_IMPEDANCE_DEPTH_M, batch),
        torsion=_filled(torsion, batch),
        rolling=_filled(rolling, batch),
        roll_give=_filled(0.0, batch),
        roll_damping=_filled(0.0, batch),
    )


def _filled(value: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    return np.broadcast_to(np.asarray(value, dtype=np.float64), shape).copy()
