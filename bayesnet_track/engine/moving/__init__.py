"""How a target moves in a frame: its motion as it stands before the evidence."""
