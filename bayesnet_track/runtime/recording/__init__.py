"""The run directory and everything that is written into it."""
