"""Messages of the processes, and the bus that carries them."""
