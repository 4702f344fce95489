"""The thesis' examples end as they should: the net reconfigures for the stated reason, at the stated time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from bayesnet_track import Result, Start, Tracker, track
from bayesnet_track.journal.events.faults import Quarantined
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.events.switches import Activated, Deactivated
from bayesnet_track.journal.net import Decision
from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.sources.scenes import Scene, make_scene
from bayesnet_track.sources.scenes.library import SceneSource


def play(graph: str, scene: Scene, seed: int) -> list[Result]:
    """Every result of a run from the scene's true first box."""
    return list(track(graph, SceneSource(scene, f"scene:{scene.name}"), [Start(scene.start_box)], seed=seed))


def overlaps(results: list[Result], scene: Scene) -> NDArray[np.float64]:
    """(n,) IoU of the estimate with the truth."""
    boxes = np.array([result.targets[0].centre_box for result in results])
    return overlap(boxes, centre_from_corner(scene.truth[: len(boxes)]))


def decisions(results: list[Result], kind: Any, node: str | None = None) -> list[Decision]:
    """All decisions of one kind (about one node)."""
    made = [decision for result in results for decision in result.decisions if isinstance(decision, kind)]
    return [decision for decision in made if node is None or getattr(decision, "node", None) == node]


@pytest.fixture(scope="module")
def crossing() -> tuple[Scene, list[Result]]:
    scene = make_scene("two_squares", 0)
    return scene, play("two_squares", scene, 0)


@pytest.mark.slow
def test_motion_is_off_early_and_on_at_both_crossings(crossing: tuple[Scene, list[Result]]) -> None:
    """The squares overlap in frames 25-34 and 174-183; motion has to be called while they come close."""
    _, results = crossing
    off = [decision.frame for decision in decisions(results, Deactivated, "motion")]
    on = [decision.frame for decision in decisions(results, Activated, "motion")]
    assert off and off[0] <= 15
    assert any(20 <= frame <= 34 for frame in on)
    assert any(168 <= frame <= 183 for frame in on)
    for frame in on:
        assert any(later > frame for later in off) or frame > 180


def test_the_right_square_is_held_with_little_more_than_one_agent(
    crossing: tuple[Scene, list[Result]],
) -> None:
    scene, results = crossing
    assert overlaps(results, scene)[-10:].mean() > 0.5
    assert np.mean([len(result.targets[0].active) for result in results[1:]]) <= 1.35


def test_every_switch_names_uncertainty_beyond_its_level(
    crossing: tuple[Scene, list[Result]],
) -> None:
    _, results = crossing
    for decision in decisions(results, Activated):
        assert isinstance(decision, Activated) and decision.cause is not None
        assert decision.cause.value > decision.cause.level and decision.cause.turning > decision.cause.level
    for decision in decisions(results, Deactivated):
        assert isinstance(decision, Deactivated)
        assert decision.cause.value < decision.cause.level and decision.node == max(
            decision.index, key=lambda agent: decision.index[agent]
        )


def test_colour_agents_are_out_on_a_gray_source() -> None:
    """They would see nothing; the journal says so, and the others track on."""
    scene = make_scene("gray_square", 0)
    tracker = Tracker("color_fusion")
    tracker.init(scene.frames[0][:, :, 0], scene.start_box)
    out = {event.node: event.reason for event in tracker.events if isinstance(event, Quarantined)}
    assert out == dict.fromkeys(("histogram", "blobs"), "needs colour, and the source is gray")
    for index in range(1, 6):
        ok, _ = tracker.update(scene.frames[index][:, :, 0])
    assert ok and set(tracker.metrics.active) <= {"intensity", "motion"}


def test_an_occluded_target_is_lost_and_found_again() -> None:
    scene = make_scene("occluder", 0)
    results = play("two_squares", scene, 0)
    states = [d.status for d in decisions(results, StatusChanged) if isinstance(d, StatusChanged)]
    hidden = scene.visible < 0.05
    assert states == ["lost", "tracking"]
    assert results[int(np.flatnonzero(hidden)[-1])].targets[0].ud_px2 > 1000
    assert overlaps(results, scene)[-5:].mean() > 0.5
