"""The thesis' stories are told by the log: which agent is switched on or off, in which frames, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from bayesnet_track import Start, track
from bayesnet_track.graph.net import Activated, Deactivated, Decision, StatusChanged
from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.runtime.run import Result
from bayesnet_track.runtime.scene_source import SceneSource
from bayesnet_track.scenes import Scene, make_scene


@dataclass(frozen=True)
class Run:
    """A run of the graph named like the scene, a target per plate."""

    scene: Scene
    results: Sequence[Result]

    def frames(self, kind: Any, node: str | None = None, target: int = 1) -> list[int]:
        """Frames of all decisions of one kind about a node."""
        return [decision.frame for decision in self.decisions(kind, node, target)]

    def decisions(self, kind: Any, node: str | None = None, target: int = 1) -> list[Any]:
        made: list[Decision] = [d for result in self.results for d in result.decisions]
        return [
            d
            for d in made
            if isinstance(d, kind) and d.target == str(target) and node in (None, getattr(d, "node", None))
        ]

    def overlaps(self, target: int = 1) -> NDArray[np.float64]:
        """(n,) IoU with the truth."""
        boxes = np.array([result.targets[target - 1].box for result in self.results])
        return overlap(boxes, centre_from_corner((self.scene.truth, *self.scene.others)[target - 1]))

    def active(self, frame: int, target: int = 1) -> set[str]:
        return set(self.results[frame].targets[target - 1].active)


def play(name: str, seed: int) -> Run:
    scene = make_scene(name, seed)
    boxes = scene.start_boxes or {None: scene.start_box}
    starts = [Start(box, plate) for plate, box in boxes.items()]
    return Run(scene, list(track(name, SceneSource(scene, f"scene:{name}"), starts, seed=seed)))


def causes_hold(run: Run) -> bool:
    """Whether every switch names an uncertainty beyond its level, in the frame and in all that it took."""
    on = [d.cause for target in (1, 2) for d in run.decisions(Activated, None, target) if d.cause is not None]
    off = [d.cause for target in (1, 2) for d in run.decisions(Deactivated, None, target)]
    return all(min(cause.value, cause.turning) > cause.level for cause in on) and all(
        max(cause.value, cause.turning) < cause.level for cause in off
    )


# ------------------------------------------------------------------------- two squares, one is hidden


def the_hidden_square_calls_for_help(run: Run) -> bool:
    """Colour alone by frame 15; intensity and motion on at 21-25 (hidden at 23), off by 45; found again.

    The gray square is left to its pattern by frame 15 and held throughout.
    """
    orange = all(
        [frame for frame in run.frames(Deactivated, agent) if frame <= 15]
        and [21 <= frame <= 25 for frame in run.frames(Activated, agent) if frame > 0] == [True]
        and run.frames(Deactivated, agent)[-1] <= 45
        for agent in ("intensity", "motion")
    )
    told = [decision.status for decision in run.decisions(StatusChanged)] == ["lost", "tracking"]
    gray = run.active(16, 2) == {"intensity"} and run.overlaps(2).min() > 0.7
    return orange and told and gray and run.active(60) == {"color"} and run.overlaps()[-10:].mean() > 0.6


@pytest.mark.parametrize("seed", [0, 1])
def test_the_hidden_square_calls_for_help(seed: int) -> None:
    run = play("orange_and_gray", seed)
    assert the_hidden_square_calls_for_help(run) and causes_hold(run)


@pytest.mark.slow
def test_twelve_hidden_squares() -> None:
    """19 of 20 seeds did it when this was written; with that, fewer than 9 of 12 has 0.2 %."""
    assert sum(the_hidden_square_calls_for_help(play("orange_and_gray", seed)) for seed in range(12)) >= 9
