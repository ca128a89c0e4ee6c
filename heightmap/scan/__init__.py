"""Heights in two dimensions for any robot, depth camera and grid:
points, a robocentric map, a small network on it.
"""
