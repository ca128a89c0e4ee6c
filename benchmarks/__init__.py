"""Measurements behind the numbers in the documentation:
`saltus bench` lists and runs them, from a checkout only.
"""
