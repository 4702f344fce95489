"""The scenes by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from difflib import get_close_matches
from types import MappingProxyType

from bayesnet_track.sources.scenes.ball import flying_ball
from bayesnet_track.sources.scenes.carried import carried_box
from bayesnet_track.sources.scenes.children import ball_between_children
from bayesnet_track.sources.scenes.crowd import crowd
from bayesnet_track.sources.scenes.occluder import occluder
from bayesnet_track.sources.scenes.parts import person_parts
from bayesnet_track.sources.scenes.passer import (
    person_color_stereo,
    person_same_clothes,
    person_same_clothes_nearer,
)
from bayesnet_track.sources.scenes.scene import Scene
from bayesnet_track.sources.scenes.silhouettes import person_and_board
from bayesnet_track.sources.scenes.squares import gray_square, orange_and_gray, two_squares
from bayesnet_track.sources.scenes.stereo import glass_wall, person_stereo
from bayesnet_track.sources.scenes.two_people import two_people_color_stereo_shape

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
        near = get_close_matches(name, _SCENES, n=1)
        hint = f"; did you mean {near[0]}?" if near else ""
        raise ValueError(f"no scene is called {name!r}; there are {', '.join(_SCENES)}{hint}")
    if seed < 0:
        raise ValueError(f"a seed is 0 or more, not {seed}")
    return replace(_SCENES[name](seed), name=name)
