"""What the journal records besides decisions, one file per theme."""
