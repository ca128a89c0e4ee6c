"""A run and a ROS 2 graph speak to each other:
heights, depth and state out, other people's robots in.
"""
