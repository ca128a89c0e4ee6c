"""Walking: a policy that follows a commanded velocity with joint targets at 50 Hz, given a height scan."""
