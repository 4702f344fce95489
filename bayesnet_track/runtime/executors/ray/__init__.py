"""Agents as Ray actors on a cluster."""
