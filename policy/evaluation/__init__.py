"""Evaluation of planners."""
