"""Joints of a robot whose base is held: replay, noise, candidates."""
