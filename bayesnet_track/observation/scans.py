"""Detections of quantities: what sensors saw in one frame, and what gives it to the engine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.planes import Frame


@dataclass(frozen=True, eq=False)
class Scan:
    """Detections of one sensor at one time.

    Attributes:
        values: (N, K) a column for each of the sensor's quantities, in the order of its `sd`.
        scores: (N,) 0..1.
    """

    values: Floats
    scores: Floats

    def __len__(self) -> int:
        return len(self.values)


@runtime_checkable
class Scanner(Protocol):
    """Sensors at work: a pure function of the frame."""

    def scans(self, frame: Frame) -> Mapping[str, Scan]:
        """Agent -> what it saw, of those that looked in this frame; one may have seen nothing."""
