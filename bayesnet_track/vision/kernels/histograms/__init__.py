"""Compiled kernels of histograms in boxes."""
