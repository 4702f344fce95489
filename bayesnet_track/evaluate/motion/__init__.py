"""Noise and modes of a motion by maximum evidence of measured boxes."""
