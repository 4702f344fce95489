"""What writes pages of the docs from the code."""
