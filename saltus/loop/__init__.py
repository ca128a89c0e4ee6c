"""A robot's own loop, written once: body, heights and planner, for one robot or a batch."""
