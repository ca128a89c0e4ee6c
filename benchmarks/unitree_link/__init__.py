"""A Go2's low level over DDS: our side against one in C, both with the same peer in C."""
