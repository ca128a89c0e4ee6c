"""One step up."""

from saltus.terrain.terrain import FINISH_AFTER_SINGLE, Terrain, build


def make(*, height_m: float) -> Terrain:
    """A platform `height_m` above the ground."""
    return build(
        "step",
        {"height_m": height_m},
        [],
        last_top=height_m,
        finish_behind=FINISH_AFTER_SINGLE,
    )
