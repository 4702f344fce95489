"""Motion models and the noise that they add."""
