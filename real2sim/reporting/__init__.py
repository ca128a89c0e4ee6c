"""The report on a verdict, for people."""
