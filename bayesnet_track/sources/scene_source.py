"""A built-in scene as a source of frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.frames import EndReason
from bayesnet_track.sources.origin import Origin
from bayesnet_track.sources.scenes.library import make_scene
from bayesnet_track.sources.scenes.scene import Scene


@dataclass(frozen=True, eq=False)
class SceneSource:
    """The frames of `scene`, 25 a second.

    Attributes:
        scene: the scene.
        description: how the journal names it.
        end: frame to stop before; None is the scene's end.
        origin: how it can be made again; None for a scene of one's own.
    """

    scene: Scene
    description: str
    end: int | None = None
    frame_interval_s: float = 0.04
    end_reason: EndReason = "end_of_source"
    origin: Origin | None = None

    @classmethod
    def named(cls, name: str, seed: int = 0, end: int | None = None) -> Self:
        """The built-in scene of this name; raises ValueError when there is none."""
        origin = Origin("scene", name, f"scene:{name}", end=end, seed=seed)
        return cls(make_scene(name, seed=seed), origin.description, end, origin=origin)

    @property
    def expected_frames(self) -> int:
        """Number of frames."""
        whole = len(self.scene.frames)
        return whole if self.end is None else min(self.end, whole)

    @property
    def width(self) -> int:
        """Columns."""
        return self.scene.width

    @property
    def height(self) -> int:
        """Rows."""
        return self.scene.height

    @property
    def truth_text(self) -> str:
        """The ground truth of its frames as text: a corner box a line."""

        return format_truth(self.scene.truth[: self.expected_frames])

    @property
    def has_depth(self) -> bool:
        """Whether the frames carry a second eye."""
        return self.scene.stereo is not None

    def __iter__(self) -> Iterator[Frame]:
        for index in range(self.expected_frames):
            stereo = self.scene.stereo
            yield Frame(
                index,
                float(index),
                self.scene.frames[index],
                True,
                round(index * self.frame_interval_s, 9),
                None if stereo is None else stereo.eye(index),
            )


def format_truth(boxes: ArrayLike) -> str:
    """The text that `read_truth` reads back to the same (n, 4) boxes, bit for bit."""
    return "".join(
        ",".join(f"{float(value)!r}" for value in row) + "\n" for row in np.asarray(boxes, dtype=np.float64)
    )
