"""The plug-in contract: planes of a frame, cues, detectors, and how installed plug-ins are found."""
