"""Several starts in each real sequence, as the VOT challenge has them: one lost frame decides less."""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
from sequences import Sequence

LEAST = 60
"""Frames without which a later start is left out."""


@dataclass(frozen=True)
class Anchors:
    """Starts at equal distances, in order or from the last frame to the first, of every `stride`th frame.

    Without `length` a start keeps all frames that follow it.
    """

    count: int = 1
    stride: int = 1
    backwards: bool = False
    length: int | None = None

    def of(self, sequence: Sequence) -> list[Sequence]:
        """The pieces, each under the sequence's name: tables weigh sequences alike, not pieces.

        The first is always there, the others where the target is visible and `LEAST` frames remain.
        """
        order = np.arange(len(sequence.files))[:: -1 if self.backwards else 1][:: self.stride]
        places = [k * len(order) // self.count for k in range(self.count)]
        pieces = [order[at:] for at in places if at == 0 or len(order) - at >= LEAST]
        return [
            Sequence(sequence.name, [sequence.files[k] for k in chosen], sequence.truth[chosen])
            for chosen in (piece[: self.length] for piece in pieces)
            if np.isfinite(sequence.truth[chosen[0]]).all()
        ]

    def __str__(self) -> str:
        """How a record of looks names them; nothing where a sequence is run as it is."""
        how = [f"{self.count} starts"] if self.count > 1 else []
        how += [f"every {self.stride} frames"] if self.stride > 1 else []
        return ", ".join([*how, "backwards"] if self.backwards else how)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options `--anchors`, `--stride` and `--backwards`."""
    parser.add_argument("--anchors", type=int, default=1, help="starts in each sequence, at equal distances")
    parser.add_argument("--stride", type=int, default=1, help="take every nth frame")
    parser.add_argument("--backwards", action="store_true", help="from the last frame to the first")


def anchors_of(options: argparse.Namespace) -> Anchors:
    """What the options say; `--max-frames` counts from each start."""
    return Anchors(options.anchors, options.stride, options.backwards, options.max_frames)
