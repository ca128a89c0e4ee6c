"""A saturation told in full: delivered torque at several commands, as a dynamometer would give it."""

import numpy as np

from real2sim.joint_drives import lost
from real2sim.joints import JointProblem
from real2sim.problem import Floats

SPACING = 5.0  # Nm between points, as in the original's table
ITERATIONS = 4
SLOPE_STEP = 0.01
"""Of finite differences: losses change by 0.05 Nm from point to point."""
STIFFNESS = 1e-6
"""Of a slope that the log does not tell, relative to the best told: it stays where it was."""


def saturation_curve(problem: JointProblem, unknowns: Floats, place: str) -> tuple[tuple[float, float], ...]:
    """Pairs of commanded and delivered torque [Nm] at one place of all legs, up to the largest command of the log.

    Args:
        problem: Of the joints.
        unknowns: Of a model with a saturation there, as fitted; shape (blocks, unknowns).
        place: E.g. "calf".
    """
    column, joint = problem.candidates_of("torque_saturation", place)
    fitted = np.median(unknowns[:, column], axis=0)
    points = np.arange(SPACING, problem.reached[joint].torque + SPACING, SPACING)
    missing = np.concatenate([[0.0], lost(points, *fitted)])
    slopes = np.diff(np.diff(missing) / SPACING, prepend=0.0)  # by how much the slope falls at each point
    rest = unknowns.copy()
    rest[:, column] = 0.0
    corners = points - SPACING
    tries = SLOPE_STEP * np.concatenate([np.zeros((1, len(slopes))), np.eye(len(slopes))])
    for _ in range(ITERATIONS):
        residuals = problem.residuals_with_hinges(rest, joint, corners, slopes + tries)
        jacobian = (residuals[1:] - residuals[0]) / SLOPE_STEP
        hessian = jacobian @ jacobian.T
        hessian += STIFFNESS * np.trace(hessian) * np.eye(len(slopes))
        slopes = slopes - np.linalg.solve(hessian, jacobian @ residuals[0])
    taken = np.sum(slopes * np.maximum(points[:, None] - corners, 0.0), axis=1)
    return tuple((float(a), float(a - b)) for a, b in zip(points, taken, strict=True))
