"""The language: specification, YAML with positions, laws, and the net with its decisions."""
