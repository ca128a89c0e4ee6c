"""What a planner is worth."""
