"""A built-in scene as a source of frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from bayesnet_track.planes import Frame
from bayesnet_track.runtime.frames import EndReason
from bayesnet_track.scenes import Scene


@dataclass(frozen=True, eq=False)
class SceneSource:
    """The frames of `scene`, 25 a second.

    Attributes:
        scene: the scene.
        description: how the journal names it.
    """

    scene: Scene
    description: str
    frame_interval_s: float = 0.04
    end_reason: EndReason = "end_of_source"

    @property
    def expected_frames(self) -> int:
        """Number of frames."""
        return len(self.scene.frames)

    def __iter__(self) -> Iterator[Frame]:
        for index in range(len(self.scene.frames)):
            yield Frame(
                index, float(index), self.scene.frames[index], True, round(index * self.frame_interval_s, 9)
            )
