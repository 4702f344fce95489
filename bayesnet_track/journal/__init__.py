"""The journal: what happened in a run, one event a line; writing, reading back, explaining."""
