"""Robots of Unitree, spoken to over their own protocol: plain DDS."""
