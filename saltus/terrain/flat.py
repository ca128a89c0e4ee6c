"""Flat ground."""

import numpy as np

from saltus.terrain.terrain import GROUND_START_X, RUN_OUT, Terrain

LENGTH = 10.0  # definition: flat ground is finished after 10 m


def make() -> Terrain:
    """Level ground with the finish 10 m ahead of the start."""
    return Terrain(
        kind="flat",
        params={},
        column_x=np.array([GROUND_START_X, LENGTH + RUN_OUT]),
        column_top=np.zeros(1),
        edges_x=np.zeros(0),
        finish_x=LENGTH,
    )
