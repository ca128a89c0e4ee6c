"""Each family of terrain at some difficulties, for tests of a law over all of them."""

from saltus.config import TerrainConfig
from saltus.terrain.curriculum import FAMILIES

KINDS = tuple(FAMILIES)
FAMILY = [
    TerrainConfig(terrain=kind, difficulty=d) for kind in KINDS for d in (None, 0.0, 0.4, 1.0)
]


def name_of(config: TerrainConfig) -> str:
    return f"{config.terrain}-{config.difficulty}"
