"""The depth camera: images against what the measured pose shows."""
