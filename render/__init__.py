"""The depth camera."""
