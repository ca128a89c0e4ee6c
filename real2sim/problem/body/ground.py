"""How the ground gives way: of a contact a log claims friction and time constant, engines want more to be said."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from saltus.arrays import Floats
from saltus.sim.free import OWN_SOLVER, Solver

SOFTER = (0.9, 0.95)
"""Impedance of contacts that engines have by default; the scene's own are stiffer, so that feet do not creep."""
GROUNDS = (
    OWN_SOLVER,
    Solver(impedance=SOFTER),
    Solver(impratio=1.0),
    Solver(impratio=1.0, impedance=SOFTER),
    Solver(impratio=1.0, impedance=SOFTER, is_pyramidal=True),
)
OTHERWISE = ((1.0, 1.0), (2.0, 1.0), (5.0, 1.0), (1.0, 0.5), (1.0, 0.15))
"""Time constant and friction, times the claimed ones: ground that is soft or slippery must not be taken for one that
creeps."""
LEAST_ROLLING_M, MOST_ROLLING_M = 0.003, 0.05
"""Friction against rolling that shows, and five times that of a Go1's feet in MuJoCo Menagerie [m]."""


def likeliest(squares: Callable[[Solver, float, float, float], Floats]) -> Solver:
    """The way to compute contacts with which a log agrees best, whatever else its robot has.

    Args:
        squares: Mean square of what is left in each window under a solver, multiples of the claimed time constant and
            friction, and friction against rolling [m], shape (w,). Their logarithms are compared: windows with much to
            explain otherwise do not decide alone.
    """

    def left(ground: Solver, softer: float = 1.0, rougher: float = 1.0, rolling: float = 0.0) -> float:
        return float(np.sum(np.log(squares(ground, softer, rougher, rolling))))

    def least(ground: Solver) -> float:
        best = min(left(ground, *other) for other in OTHERWISE)
        if left(ground, rolling=LEAST_ROLLING_M) > left(ground):
            return best
        # feet that resist rolling look like ground that creeps, until it is known how much they do
        bounds = LEAST_ROLLING_M, MOST_ROLLING_M
        found = minimize_scalar(
            lambda x: left(ground, rolling=x), bounds=bounds, method="bounded", options={"maxiter": 8}
        )
        return min(best, float(found.fun))

    return min(GROUNDS, key=least)


def finer(ground: Solver) -> Sequence[Solver]:
    """The same contacts, computed with half and with a quarter of the step."""
    return replace(ground, substeps=2), replace(ground, substeps=4)
