"""Policies that answer with joint targets: observation,
network, and their part in the planner's process.
"""
