"""Run logs with effects hidden in them: how often does real2sim find,
name and measure what is there?

Nothing here shares code with what it tests: robot, drives, sensors, integrator and noise are
written a second time, in other formulas, from the definitions of the run log alone.
"""
