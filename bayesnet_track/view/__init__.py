"""Pictures of a run: the overlay on frames, the net, UD over time. Reads the journal, never the engine."""
