"""What a stated standard deviation of a height means."""

import math

INTERVAL90 = 1.645
"""So many of them to each side hold 90 % of the errors: by this they are fitted. For normal errors it is the usual
standard deviation; real errors have heavier tails, so it is not the root of their mean square."""
LAPLACE90 = math.log(10.0)
"""So many scales of a Laplace law to each side hold 90 % of it. Its tails are nearer to those of the errors."""
