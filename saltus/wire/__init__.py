"""What processes say to each other, and the bus that carries it."""
