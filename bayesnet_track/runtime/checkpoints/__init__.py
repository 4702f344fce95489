"""Checkpoints, resuming, and replaying with another value."""
