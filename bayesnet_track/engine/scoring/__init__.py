"""How sure a target is held: the score of a frame, look-alikes, and what follows it over frames."""
