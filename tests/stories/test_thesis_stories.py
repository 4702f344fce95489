"""The thesis' stories are told by the log: which agent is switched on or off, in which frames, and why.

What each story asks for stands in `benchmarks/stories.py`, which counts them over more seeds.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bayesnet_track import Start, track
from bayesnet_track.journal.events.switches import SelfStopped
from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.sources.scenes.library import SceneSource
from bayesnet_track.sources.scenes.shapes import occluder

PLACE = Path(__file__).parents[2] / "benchmarks" / "stories.py"


@pytest.fixture(scope="module")
def stories() -> Iterator[Any]:
    found = importlib.util.spec_from_file_location("stories", PLACE)
    assert found is not None and found.loader is not None
    module = importlib.util.module_from_spec(found)
    sys.modules[found.name] = module  # where dataclasses look up their annotations
    found.loader.exec_module(module)
    yield module
    del sys.modules[found.name]


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        ("orange_and_gray", 0),
        ("gray_square", 1),
        ("person_and_board", 0),
        pytest.param("person_color_stereo", 0, marks=pytest.mark.slow),
        pytest.param("person_same_clothes_nearer", 0, marks=pytest.mark.slow),
    ],
)
def test_the_log_tells_the_story(stories: Any, name: str, seed: int) -> None:
    run = stories.STORIES[name].played(seed)
    assert stories.STORIES[name].is_told(run)
    assert stories.causes_hold(run)
    untold = [replace(result, decisions=()) for result in run.results]
    assert not stories.STORIES[name].is_told(stories.Run(run.scene, untold))


@pytest.mark.slow
def test_color_fusion_tells_its_story_in_most_seeds(stories: Any) -> None:
    """It was told in 19 of 20 seeds; with a share of 0.95 fewer than 8 of 10 have a probability of 1 %."""
    story = stories.STORIES["color_fusion"]
    assert sum(story.is_told(story.played(seed)) for seed in range(10)) >= 8


@pytest.mark.slow
def test_color_fusion_finds_the_square_again_behind_an_occluder() -> None:
    """It did in 24 of 24 runs; with a share of 0.95 fewer than 9 of 12 have a probability of 0.2 %.

    Seeds of neither the choice of `relocalize` (100 to 135) nor the report (0 to 23).
    """
    again = 0
    for seed in range(200, 212):
        scene = occluder(seed, hidden=11)
        x, y, w, h = scene.start_box
        results = list(
            track("color_fusion", SceneSource(scene, "scene:occluder"), [Start((x, y, w, h))], seed=seed)
        )
        boxes = np.array([result.targets[0].centre_box for result in results[-10:]])
        again += overlap(boxes, centre_from_corner(scene.truth[-10:])).mean() > 0.5
    assert again >= 9


@pytest.mark.slow
def test_two_people_are_each_followed_by_what_is_reliable(stories: Any) -> None:
    run = stories.STORIES["two_people_color_stereo_shape"].played(0)
    assert stories.colour_alone_until_the_daylight(run)
    assert stories.shape_stops_itself_in_the_glare(run)
    assert stories.causes_hold(run)
    (stop,) = run.decisions(SelfStopped, "shape", 2)
    assert min(stop.cause.value, stop.cause.turning) > stop.cause.level == 200


@pytest.mark.slow
@pytest.mark.parametrize("name", ["person_color_stereo", "person_same_clothes_nearer"])
def test_twelve_times(stories: Any, name: str) -> None:
    """At least 19 of 20 seeds did it when this was written; with 19, fewer than 8 of 12 has below 0.1 %."""
    assert sum(stories.STORIES[name].is_told(stories.STORIES[name].played(seed)) for seed in range(12)) >= 8
