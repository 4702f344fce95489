"""Beliefs given the whole sequence: backward over what was filtered."""
