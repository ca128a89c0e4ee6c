"""Flat ground."""

from saltus.terrain.terrain import GROUND_START_X, RUN_OUT, Terrain, boxes_across

LENGTH = 10.0  # definition: flat ground is finished after 10 m


def make() -> Terrain:
    """Level ground with the finish 10 m ahead of the start."""
    return Terrain(
        kind="flat", boxes=boxes_across([GROUND_START_X, LENGTH + RUN_OUT], [0.0]), finish_x=LENGTH
    )
