"""Annotations in other tools' formats, written and read."""
