"""How a target moves in a frame: its motion before the evidence, and the search for a fast move."""
