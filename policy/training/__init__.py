"""From the environment to a model file."""
