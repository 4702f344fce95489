"""Many videos with one graph: what is to be done, where it is done, and the table of what came of it."""
