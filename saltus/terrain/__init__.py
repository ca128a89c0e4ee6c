"""Terrains made of boxes, with exact heights; see `saltus.terrain.terrain`."""
