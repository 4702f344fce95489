"""Where files of networks are looked for: as a graph names them, then in folders of models.

A folder of models is `models` where the program is started, or those that the environment variable
`BAYESNET_TRACK_MODELS` lists, separated as in `PATH`. A graph that names a file without its folder then runs
on every machine that has the file in one of its own.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator

VARIABLE = "BAYESNET_TRACK_MODELS"
"""Lists folders of models."""
NANOTRACK = ("nanotrack_backbone_v2.onnx", "nanotrack_head_v2.onnx")
"""Backbone and head as their authors name them."""


def model_folders() -> list[Path]:
    """The folders in which models are looked for, in this order; they need not exist."""
    listed = [folder for folder in os.environ.get(VARIABLE, "").split(os.pathsep) if folder]
    return [Path(folder).expanduser() for folder in listed] or [Path("models")]


def find_model(path: str) -> str:
    """The path itself where there is such a file, else the first in the `model_folders`; itself if none is.

    >>> find_model("no_such_network.onnx")
    'no_such_network.onnx'
    """
    if not path or Path(path).is_file():
        return path
    return next((str(folder / path) for folder in model_folders() if (folder / path).is_file()), path)


def find_nanotrack() -> tuple[str, str] | None:
    """Backbone and head of NanoTrack v2 in the folders of models; None where one of them is missing."""
    backbone, head = map(find_model, NANOTRACK)
    return (backbone, head) if Path(backbone).is_file() and Path(head).is_file() else None


ModelFile = Annotated[str, AfterValidator(find_model)]
"""The path of a network's file, looked for in the folders of models too."""
