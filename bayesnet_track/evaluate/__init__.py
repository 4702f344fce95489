"""Scores of a run against ground truth: accuracy, calibration, speed."""
