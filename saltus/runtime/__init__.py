"""The processes of a run: who starts them, and the clock that they keep."""
