"""The plant in MuJoCo: one robot, or many at once."""
