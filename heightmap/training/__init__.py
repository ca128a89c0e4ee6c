"""From episodes to a model file."""
