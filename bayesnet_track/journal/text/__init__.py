"""Sentences of the log: events, decisions and comparisons in words."""
