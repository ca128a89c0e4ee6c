"""True where a log can be believed, and whether its clocks agree."""
