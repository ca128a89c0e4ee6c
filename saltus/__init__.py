"""Saltus: a legged robot that sees where it steps. Import the modules you need; this file imports nothing."""
