"""The live net, the decisions that change it, and their application: pure and replayable."""
