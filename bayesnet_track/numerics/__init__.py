"""The numerical atoms: weights, boxes, random streams, compiled kernels. Imports nothing of the project."""
