"""Stereo matching, calibration and what is learnt of depth."""
