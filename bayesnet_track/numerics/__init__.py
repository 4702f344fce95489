"""The numerical atoms: log-weights, boxes, random streams, compiled kernels. Imports nothing of the project."""
