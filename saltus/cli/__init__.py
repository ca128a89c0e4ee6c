"""The command line `saltus`."""
