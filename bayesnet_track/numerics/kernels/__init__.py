"""Compiled loops over samples, cells and pairs."""
