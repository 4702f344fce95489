"""The language: specification, YAML with positions, checks, and the net with its decisions."""
