"""Constants of every robot: the rates at which time goes on,
gravity, and a number of statistics.
"""

PHYSICS_DT = 0.002
"""Period of physics and leg controller [s]: 500 Hz."""
POLICY_STEPS = 5
"""Physics steps in a step of the motion policy: 100 Hz."""
POLICY_DT = PHYSICS_DT * POLICY_STEPS
"""Period of the motion policy [s]."""
PUSH_STEPS = 10
"""Steps of the motion policy that a push lasts: 0.1 s, about what a person's shove takes."""
GRAVITY = 9.81
"""[m/s^2]; the engine's default, and the original's."""
LOADED_N = 5.0
"""Force from which a foot bears load: above the noise of one that grazes the ground."""
FORCE_M_PER_N = 0.3 / 60.0
"""Length of the arrows of forces in pictures [m/N]: 0.3 m for what one of two legs bears of a robot
of 12 kg."""
NORMAL_90 = 1.645
"""Half of the 90 % interval of a normal law, in standard deviations."""
