"""Where simulation and measurement disagree, and which effects explain it."""
