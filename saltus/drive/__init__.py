"""The operator's process: it commands a robot by a script, to goals, or by keys."""
