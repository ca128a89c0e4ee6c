"""Settings of flights that take a test little time."""

from dataclasses import replace

from saltus.heightmap.scan.training.settings import FlightSettings

SMALL = FlightSettings(rows=12, columns=16, samples=96, images=8, rate_hz=(15.0, 40.0))
EXACT = replace(SMALL, errors=0.0, odometry=(0.0, 0.0))
"""Images, calibration and odometry without errors."""
