"""A swinging leg of the benchmark of hidden effects."""

import numpy as np

from benchmarks.hidden_effects.robot import STAND


def swing(rows: int) -> np.ndarray:
    t = np.arange(rows) * 0.002
    command = np.zeros((rows, 12, 3))
    command[:, :, 0] = STAND + 0.3 * np.sin(2 * np.pi * 2 * t)[:, None] * np.tile([1, -0.7, 0.7], 4)
    command[:, :, 2] = 0.5 * np.sin(7 * t)[:, None]
    return command
