"""Unknowns to residuals, for each kind of sensor."""
