"""Checks of the installation, each with its cure. Nothing here imports a library that may be broken."""
