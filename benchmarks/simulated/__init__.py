"""Scenes that only benchmarks and tests need, and the scores of detections in them."""
