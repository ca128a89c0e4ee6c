"""How the ground gives way: of a contact a log claims friction and time constant, engines want more to be said."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from saltus.arrays import Floats
from saltus.sim.free_robots import OWN_SOLVER, Solver

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
"""Time constant and friction, times the claimed ones, which come first: ground that is soft or slippery must not be
taken for one that creeps."""
LEAST_ROLLING_M, MOST_ROLLING_M = 0.003, 0.05
"""Friction against rolling that shows, and five times that of a Go1's feet in MuJoCo Menagerie [m]."""


def likeliest(squares: Callable[[Solver, Floats], Floats]) -> Solver:
    """The way to compute contacts with which a log agrees best, whatever else its robot has.

    Args:
        squares: Mean square of what is left in each window under a solver, for n robots and grounds together, shape
            (n, w): multiples of the claimed time constant and friction, and friction against rolling [m], shape (n, 3).
            Their logarithms are compared: windows with much to explain otherwise do not decide alone.
    """

    def left(ground: Solver, *others: tuple[float, float, float]) -> Floats:
        return np.asarray(np.sum(np.log(squares(ground, np.array(others))), axis=1))

    def rolling(ground: Solver, friction: float) -> float:
        return float(left(ground, (1.0, 1.0, friction))[0])

    def least(ground: Solver) -> float:
        otherwise = left(ground, *((softer, rougher, 0.0) for softer, rougher in OTHERWISE))
        best, claimed = float(np.min(otherwise)), float(otherwise[0])
        if rolling(ground, LEAST_ROLLING_M) > claimed:
            return best
        # feet that resist rolling look like ground that creeps, until it is known how much they do
        bounds = LEAST_ROLLING_M, MOST_ROLLING_M
        found = minimize_scalar(lambda x: rolling(ground, x), bounds=bounds, method="bounded", options={"maxiter": 8})
        return min(best, float(found.fun))

    return min(GROUNDS, key=least)


def finer(ground: Solver) -> Sequence[Solver]:
    """The same contacts, computed with half and with a quarter of the step."""
    return replace(ground, substeps=2), replace(ground, substeps=4)
