"""Motions that make effects visible, and which of them would settle a question."""
