"""What went wrong in a run, and which key of its graph to turn."""
