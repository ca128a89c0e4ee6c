"""Robots that answer joint commands, simulated or real."""
