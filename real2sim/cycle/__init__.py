"""The cycle: a robot runs, its logs are searched,
what is found is trained with, and the robot runs again.
"""
