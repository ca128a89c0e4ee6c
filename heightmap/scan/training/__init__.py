"""How the network of the scan came about: ground, motion,
cameras and odometry in plain torch, without physics.
"""
