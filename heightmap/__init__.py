"""From depth images to a heightmap."""
