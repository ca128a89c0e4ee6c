"""Robots as data: what a robot is, how it is read from an MJCF, where its feet are."""
