"""What is computed from pictures: feature planes, shapes, stereo, points. Cues and detectors read it."""
