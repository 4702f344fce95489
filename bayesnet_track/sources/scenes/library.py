"""Scenes by name, and a scene as a source of frames."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from types import MappingProxyType
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.frames import EndReason
from bayesnet_track.sources.origin import Origin
from bayesnet_track.sources.scenes.people import carried_box, person_and_board, person_parts, street
from bayesnet_track.sources.scenes.scene import Scene
from bayesnet_track.sources.scenes.shapes import (
    ball_between_children,
    crowd,
    flying_ball,
    gray_square,
    occluder,
    orange_and_gray,
    two_squares,
)
from bayesnet_track.sources.scenes.stereo import (
    glass_wall,
    person_color_stereo,
    person_same_clothes,
    person_same_clothes_nearer,
    person_stereo,
    two_people_color_stereo_shape,
)

_SCENES: Mapping[str, Callable[[int], Scene]] = MappingProxyType(
    {
        "two_squares": two_squares,
        "orange_and_gray": orange_and_gray,
        "gray_square": gray_square,
        "ball_between_children": ball_between_children,
        "carried_box": carried_box,
        "crowd": crowd,
        "flying_ball": flying_ball,
        "person_and_board": person_and_board,
        "person_parts": person_parts,
        "occluder": occluder,
        "occluder_long": lambda seed: occluder(seed, hidden=22),
        "person_stereo": person_stereo,
        "glass_wall": glass_wall,
        "person_color_stereo": person_color_stereo,
        "person_same_clothes": person_same_clothes,
        "person_same_clothes_nearer": person_same_clothes_nearer,
        "two_people_color_stereo_shape": two_people_color_stereo_shape,
        "street": street,
    }
)


def scene_names() -> tuple[str, ...]:
    """The names that `make_scene` knows."""
    return tuple(_SCENES)


def make_scene(name: str, seed: int = 0) -> Scene:
    """The scene of that name; the same name and seed give the same pixels.

    Raises:
        ValueError: no such scene, or a negative seed.
    """
    if name not in _SCENES:
        suggestions = get_close_matches(name, _SCENES, n=1)
        hint = f"; did you mean {suggestions[0]}?" if suggestions else ""
        raise ValueError(f"no scene is called {name!r}; there are {', '.join(_SCENES)}{hint}")
    if seed < 0:
        raise ValueError(f"a seed is 0 or more, not {seed}")
    return replace(_SCENES[name](seed), name=name)


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
        total = len(self.scene.frames)
        return total if self.end is None else min(self.end, total)

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
        """True if the frames carry a second eye."""
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
