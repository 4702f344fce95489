"""The checks that a graph must pass, one file per subject."""
