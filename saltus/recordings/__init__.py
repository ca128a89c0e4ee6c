"""Recordings and logs of runs, and what is read from them afterwards."""
