"""A law of the candidates of every sensor's problem."""

import numpy as np

from saltus.real2sim.problem.problem import Problem


def check_stated_values(problem: Problem) -> None:
    """What a profile has is taken from its values exactly:
    a candidate says its unknowns for its parameters.

    Also at the ends of their ranges. Unknowns for which the effect has no parameter are then 0.
    """
    for candidate in problem.candidates:
        if candidate.is_nuisance or candidate.effect == "torque_saturation":
            continue
        for share in (0.0, 0.3, 1.0):
            unknowns = np.array(
                [u.stated or u.low + share * (u.high - u.low) for u in candidate.unknowns]
            )
            parameters = {
                name: found.value for name, found in candidate.parameters(unknowns).items()
            }
            told = np.where([u.is_told for u in candidate.unknowns], unknowns, 0.0)
            told = np.where([u.is_choice for u in candidate.unknowns], np.round(told), told)
            np.testing.assert_allclose(
                candidate.unknowns_of(parameters), told, rtol=1e-6, atol=1e-9
            )
