"""From a motion plan to joint commands."""
