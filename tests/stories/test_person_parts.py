"""A person as head and torso: a hidden part is told from the one that is seen."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track import Result, Start, track
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.events.switches import Activated
from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.sources.scenes import Scene, make_scene
from bayesnet_track.sources.scenes.library import SceneSource


def play(scene: Scene, seed: int) -> list[Result]:
    source = SceneSource(scene, "scene:person_parts")
    return list(track("person_parts", source, [Start(scene.start_box)], seed=seed))


def errors(scene: Scene, results: list[Result], name: str) -> np.ndarray:
    """(n,) distance of a part's estimate from its true centre, px."""
    at = np.array([result.targets[0].parts[name].centre_box[:2] for result in results])
    away: np.ndarray = np.hypot(*(at - centre_from_corner(scene.parts[name].truth)[:, :2]).T)
    return away


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene("person_parts", 0)


@pytest.fixture(scope="module")
def results(scene: Scene) -> list[Result]:
    return play(scene, 0)


def test_one_part_at_a_time_is_hidden(scene: Scene) -> None:
    hidden = {name: np.flatnonzero(part.visible < 0.05) for name, part in scene.parts.items()}
    assert set(hidden) == {"head", "torso"}
    assert len(hidden["torso"]) > 45 and len(hidden["head"]) > 25
    assert scene.parts["head"].visible[hidden["torso"]].min() > 0.8
    assert scene.parts["torso"].visible[hidden["head"]].min() > 0.8
    assert [part.visible[0] for part in scene.parts.values()] == pytest.approx([1.0, 1.0])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["head", "torso"])
def test_the_hidden_part_is_told_from_the_other(scene: Scene, results: list[Result], name: str) -> None:
    """`given` has sd 2.5 and 1 px for each part; the head leans by 2.5 px, which no other part can tell.

    So the hidden part is known to sqrt(2 (2.5^2 + 1^2)) = 3.8 px besides what the seen part's agents leave
    open, some 2 px: 4.3 px is the expected length of the error, and a third of the torso's width its bound.
    """
    hidden = scene.parts[name].visible < 0.05
    away = errors(scene, results, name)
    assert away[hidden].mean() < 4.3
    assert away.max() < 11
    parts = [result.targets[0].parts[name] for result in results]
    uds = np.array([part.ud_px2 for part in parts])
    whole = scene.parts[name].visible > 0.95
    assert uds[hidden].mean() > 1.5 * uds[whole].mean()
    statuses = np.array([part.status for part in parts])
    assert (statuses[hidden] == "hidden").all()
    assert (statuses[whole] == "seen").mean() > 0.95


@pytest.mark.slow
def test_the_pattern_is_called_when_the_torso_is_uncertain(results: list[Result]) -> None:
    """The torso goes into hiding from frame 8 on, and is hidden from 19 on."""
    decisions = [decision for result in results for decision in result.decisions]
    called = [one for one in decisions if isinstance(one, Activated) and one.node == "pattern"]
    assert called and 8 <= called[0].frame <= 22 and called[0].governor == "torso"
    assert not [one for one in decisions if isinstance(one, StatusChanged)]


@pytest.mark.slow
def test_eight_more_walks() -> None:
    for seed in range(1, 9):
        scene = make_scene("person_parts", seed)
        results = play(scene, seed)
        for name, part in scene.parts.items():
            away = errors(scene, results, name)
            assert away[part.visible < 0.05].mean() < 6.0, (seed, name)
            assert away[-10:].max() < 11, (seed, name)
