"""The body on the ground: short replays, candidates."""
