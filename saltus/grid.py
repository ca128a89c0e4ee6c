"""The grid of the heightmap."""

import numpy as np

HEIGHTMAP_X = np.linspace(-0.4, 0.8, 30)
"""Distance of each height ahead of the base along its yaw [m]; original: 30 points on one line."""
