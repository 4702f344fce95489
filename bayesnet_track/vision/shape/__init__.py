"""Contours and the statistical model of their shape."""
