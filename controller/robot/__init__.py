"""What answers joint commands, simulated or real."""
