"""The built-in feature planes of a frame."""
