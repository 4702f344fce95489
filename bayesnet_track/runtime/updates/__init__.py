"""What the trackers of a program's own loop have in common: times of frames, turns of threads, storing."""
