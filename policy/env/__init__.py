"""The environment in which the policy learns."""
