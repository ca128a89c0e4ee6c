"""The IMU against the measured base."""
