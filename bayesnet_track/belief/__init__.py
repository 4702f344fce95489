"""Beliefs: representations of where a target is, motion models, estimates."""
