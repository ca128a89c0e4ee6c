"""The body and its drives while a robot jumps:
what must act for the measured motion, against what its drives give.
"""
