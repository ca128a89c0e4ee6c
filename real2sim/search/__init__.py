"""The search for missing effects; it knows nothing of robots."""
