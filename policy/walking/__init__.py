"""Walking: a policy that follows a commanded velocity with joint targets, given a height scan."""
