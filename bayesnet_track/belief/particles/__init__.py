"""The particle belief: proposals, sample sizes, passes over hypotheses."""
