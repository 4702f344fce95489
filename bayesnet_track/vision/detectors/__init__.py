"""The built-in detectors, one file each; found through the entry-point group ``bayesnet_track.detectors``."""
