"""Running on real input: sources of frames, the run directory and its files, the run loop, `Tracker`."""
