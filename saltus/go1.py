"""The Unitree Go1 as data. Legs FR, FL, RR, RL; joints hip (abduction), thigh, calf; SI units.

Sources: "unitree_ros": Unitree's published robot description (newer version, with rotors); "original": the
controller settings of the authors of "Agile Continuous Jumping in Discontinuous Terrains".
"""

import numpy as np

# Geometry (unitree_ros)
HIP_ANCHOR = np.array(
    [[0.1881, -0.04675, 0.0], [0.1881, 0.04675, 0.0], [-0.1881, -0.04675, 0.0], [-0.1881, 0.04675, 0.0]]
)
"""Abduction axis of each leg in the base frame [m], shape (4, 3)."""
SIDE = np.array([-1.0, 1.0, -1.0, 1.0])
"""+1 for left legs, -1 for right legs."""
ABDUCTION_LENGTH = 0.08
THIGH_LENGTH = 0.213
CALF_LENGTH = 0.213  # to the centre of the foot sphere
FOOT_RADIUS = 0.02
TRUNK_SIZE = np.array([0.3762, 0.0935, 0.114])  # full edge lengths of the collision box

# Masses [kg] (unitree_ros, rotors lumped into the link that carries them): 5.204 + 4 (0.68 + 1.009 + 0.195862)
TRUNK_MASS = 5.204
HIP_MASS = 0.591 + 0.089
THIGH_MASS = 0.92 + 0.089
CALF_MASS = 0.135862 + 0.06  # with foot
MASS = TRUNK_MASS + 4 * (HIP_MASS + THIGH_MASS + CALF_MASS)  # 12.743 kg

# Rotor inertia about the motor's axis [kg m^2], seen through the reduction at the joint (unitree_ros)
ROTOR_INERTIA = 1.118e-4
REDUCTION = np.tile([4.22, 4.22, 6.33], 4)  # original: 6.33 at the knee; 6.33 / 1.5 at hip and thigh
ARMATURE = ROTOR_INERTIA * REDUCTION**2  # 0.00199 / 0.00199 / 0.00448

# Limits (unitree_ros)
JOINT_LOWER = np.tile([-0.863, -0.686, -2.818], 4)
JOINT_UPPER = np.tile([0.863, 4.501, -0.888], 4)
TORQUE_LIMIT = np.tile([23.7, 23.7, 35.55], 4)
SPEED_LIMIT = np.tile([30.1, 30.1, 20.06], 4)

# Pose in which the robot stands, and the height of its base above the ground there (original)
STAND_POSE = np.tile([0.0, 0.9, -1.8], 4)
STAND_HEIGHT = 0.268
STAND_KP = 100.0

SWING_FOOT_Z = (-0.4, 0.1)
"""Height of a swinging foot in the base frame [m]: the leg controller keeps within it, and a policy is trained with
it. The original ends at -0.1, and names 0.1 for high steps: with it a foot can be drawn up in front of the body."""

# The camera's mount in the base frame (original): a printed mount in front of the trunk, 30 degrees nose down
CAMERA_POSITION = np.array([0.272, 0.0075, 0.092])
CAMERA_PITCH = 0.52
