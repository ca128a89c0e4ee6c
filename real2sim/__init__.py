"""Where simulation and measurement disagree, and which effect explains it."""
