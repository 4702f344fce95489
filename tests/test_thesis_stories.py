"""The thesis' stories are told by the log: which agent is switched on or off, in which frames, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from bayesnet_track import Start, track
from bayesnet_track.graph.net import Activated, Deactivated, Decision, SelfStopped, StatusChanged
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


def test_the_hidden_square_calls_for_help() -> None:
    run = play("orange_and_gray", 0)
    assert the_hidden_square_calls_for_help(run) and causes_hold(run)


@pytest.mark.slow
def test_twelve_hidden_squares() -> None:
    """19 of 20 seeds did it when this was written; with that, fewer than 9 of 12 has 0.2 %."""
    assert sum(the_hidden_square_calls_for_help(play("orange_and_gray", seed)) for seed in range(12)) >= 9


# ------------------------------------------------------------------------- depth, until somebody comes close


def colour_is_called_when_somebody_comes(run: Run) -> bool:
    """Stereo throughout; colour off by 20, on at 66-76 (he stands there from 66 on), off by 95, once each.

    At the peak UD was above 200 px2 in five frames; colour brings it below half of that within six more.
    """
    (on, *more), off = run.frames(Activated, "color") or [0], run.frames(Deactivated, "color")
    ud = np.array([result.targets[0].ud_px2 for result in run.results])
    return (
        not more
        and len(off) == 2
        and off[0] <= 20
        and 66 <= on <= 76
        and on + 5 <= off[1] <= 95
        and ud[on - 4 : on + 1].min() > 200
        and ud[on + 1 : on + 7].min() < 0.5 * ud[on - 4 : on + 1].max()
        and all("stereo" in run.active(frame) for frame in range(len(ud)))
        and bool(run.overlaps()[[*range(60, 100)]].min() > 0.4)
    )


def test_colour_is_called_when_somebody_comes() -> None:
    run = play("person_color_stereo", 0)
    assert colour_is_called_when_somebody_comes(run) and causes_hold(run)


@pytest.mark.slow
def test_twelve_visits() -> None:
    """19 of 20 seeds did it when this was written; with that, fewer than 8 of 12 has below 0.1 %."""
    assert sum(colour_is_called_when_somebody_comes(play("person_color_stereo", s)) for s in range(12)) >= 8


# ------------------------------------------------------------------------- two people, three cues

DAYLIGHT, GLARE = (58, 70), (76, 100)


def colour_alone_until_the_daylight(run: Run) -> bool:
    """Left: colour alone by 35; one other on as the daylight comes; off again by 95; held throughout."""
    agents = ("stereo", "shape")
    on = [frame for agent in agents for frame in run.frames(Activated, agent)]
    off = [frame for agent in agents for frame in run.frames(Deactivated, agent)]
    return (
        all(run.active(frame) == {"color"} for frame in range(36, 58))
        and len(on) == 1
        and DAYLIGHT[0] <= on[0] <= DAYLIGHT[0] + 5
        and len(off) == 3
        and DAYLIGHT[1] < max(off) <= 95
        and run.active(110) == {"color"}
        and bool(run.overlaps().min() > 0.5)
    )


def shape_stops_itself_in_the_glare(run: Run) -> bool:
    """Right: colour off by 12; not back for the flickers at 30 and 50, but in the glare; shape stops itself.

    Both are undone after it.
    """
    stopped, color = run.frames(SelfStopped, "shape", 2), run.frames(Activated, "color", 2)
    back, off = run.frames(Activated, "shape", 2), run.frames(Deactivated, "color", 2)
    return (
        len(stopped) == len(color) == len(back) == 1
        and len(off) == 2
        and off[0] <= 12
        and GLARE[0] <= stopped[0] <= GLARE[0] + 8
        and GLARE[0] <= color[0] <= GLARE[0] + 8
        and GLARE[1] - 4 <= back[0] < off[1] <= 115
        and run.active(60, 2) == {"stereo", "shape"} == run.active(118, 2)
        and run.active(90, 2) == {"stereo", "color"}
        and bool(run.overlaps(2)[-10:].mean() > 0.8)
    )


def two_people(run: Run) -> bool:
    """Both stories."""
    return colour_alone_until_the_daylight(run) and shape_stops_itself_in_the_glare(run)


@pytest.mark.slow
def test_two_people_are_each_followed_by_what_is_reliable() -> None:
    run = play("two_people_color_stereo_shape", 0)
    assert colour_alone_until_the_daylight(run) and shape_stops_itself_in_the_glare(run)
    assert causes_hold(run)
    (stop,) = run.decisions(SelfStopped, "shape", 2)
    assert min(stop.cause.value, stop.cause.turning) > stop.cause.level == 200
