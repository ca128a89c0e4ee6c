"""From a heightmap to a motion plan."""
