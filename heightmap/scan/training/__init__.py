"""Origin of the network of the scan: ground, motion,
cameras and odometry in plain torch, without physics.
"""
