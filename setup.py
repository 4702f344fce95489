"""Find the packages; `cues/` and `graphs/` stand at the top level and are mapped in pyproject.toml."""

from setuptools import find_packages, setup

setup(packages=[*find_packages(include=["bayesnet_track*"]), "bayesnet_track.cues", "bayesnet_track.graphs"])
