"""Track management: births, ends, association and re-identification."""
