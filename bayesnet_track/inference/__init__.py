"""Inference over a net: compile it to a plan, then pass messages over hypotheses."""
