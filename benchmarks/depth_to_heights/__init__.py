"""The benchmark of depth to heights: a fixed split,
what predictors are given of it, and how they are scored.
"""
