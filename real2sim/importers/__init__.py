"""Logs of others, as run logs."""
