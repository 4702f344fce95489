"""The ball in flight takes more hypotheses, and fewer again with an importance function (thesis 5.6)."""

import numpy as np
import pytest

from bayesnet_track import GraphSpec, Start, load_graph, track
from bayesnet_track.graph.text.write import as_plain
from bayesnet_track.journal.events.beliefs import ParticlesResized, SecondPass
from bayesnet_track.journal.events.switches import Deactivated
from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource

NAME = "ball_between_children"
LEAPS = [*range(3, 9), *range(23, 29)]
HELD = [*range(13, 22), *range(33, 45)]


class Kept:
    """A sink that keeps the events."""

    def __init__(self):
        self.events = []

    def event(self, event):
        self.events.append(event)

    def frame(self, result):
        pass


def run(seed, importance=None):
    """(2, n, 3): ball and child; particles, KL, error of the centre; and the events."""
    data = as_plain(load_graph(NAME).spec)
    for plate, root in (("ball", "ball"), ("child", "child")):
        if importance is not None:
            data["targets"][plate]["nodes"][root]["belief"]["particles"]["proposal"] = importance
    scene, kept = make_scene(NAME, seed), Kept()
    starts = [Start(box, plate) for plate, box in scene.starts]
    truth = [centre_from_corner(path)[:, :2] for path in (scene.truth, scene.others[0])]
    rows = []
    for result in track(
        GraphSpec.model_validate(data), SceneSource(scene, NAME), starts, seed=seed, sinks=[kept]
    ):
        at = result.frame.index
        rows.append(
            [
                (one.particles, one.surprise, np.hypot(*(one.centre_box[:2] - truth[k][at])))
                for k, one in enumerate(result.targets)
            ]
        )
    return np.array(rows).transpose(1, 0, 2), kept.events


pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=[range(2), range(2, 6)])
def runs(request):
    """Some seeds, as the graph is and with the motion model alone."""
    return {kind: [run(seed, kind) for seed in request.param] for kind in (None, "bootstrap")}


def mean(runs, target, frames, column):
    return np.mean([numbers[target][frames, column] for numbers, _ in runs])


def test_both_are_held(runs):
    for some in runs.values():
        assert max(numbers[0][:, 2].max() for numbers, _ in some) < 11.0  # half of the ball
        assert max(numbers[1][:, 2].max() for numbers, _ in some) < 23.0  # half of the child's width


def test_flight_asks_for_more_hypotheses_and_the_importance_function_for_fewer(runs):
    """Over 20 seeds 2,480 in flight and 1,340 held, and 1,510 in flight with the importance function."""
    held, flight = mean(runs["bootstrap"], 0, HELD, 0), mean(runs["bootstrap"], 0, LEAPS, 0)
    again = mean(runs[None], 0, LEAPS, 0)
    assert flight > 1.4 * held
    assert again < 0.8 * flight
    assert mean(runs[None], 0, LEAPS, 2) < mean(runs["bootstrap"], 0, LEAPS, 2)


def test_flight_is_a_surprise(runs):
    """The KL of thesis Figure 5.13: high for the ball in flight, low for the child throughout."""
    assert mean(runs["bootstrap"], 0, LEAPS, 1) > mean(runs["bootstrap"], 0, HELD, 1) + 0.5
    assert mean(runs["bootstrap"], 1, slice(5, None), 1) < 1.5


def test_the_child_needs_the_least_number(runs):
    for numbers, _ in runs["bootstrap"]:
        assert (numbers[1][:, 0] == 500).all()


def test_the_log_names_each(runs):
    for _, events in runs[None]:
        second = [event.frame for event in events if isinstance(event, SecondPass) and event.target == "1"]
        assert set(second) & set(LEAPS[:6]) and set(second) & set(LEAPS[6:])
        resized = [event for event in events if isinstance(event, ParticlesResized)]
        assert any(event.frame in LEAPS and event.particles > event.before for event in resized)
        dropped = [event for event in events if isinstance(event, Deactivated)]
        assert [(event.target, event.node) for event in dropped][:1] == [("2", "histogram")]
        assert dropped[0].frame <= 6
