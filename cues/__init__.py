"""The built-in cues, one file each; found through the entry-point group ``bayesnet_track.cues``."""
