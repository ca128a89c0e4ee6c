"""The paper's experiments, row by row: what it shows, and the same made of the shipped models."""
