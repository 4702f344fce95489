"""Every belief of the language at work: real cues, adaptation, the run directory, several targets."""

import copy

import numpy as np
import pytest
import yaml

from bayesnet_track import GraphSpec, Start, track
from bayesnet_track.graphs import find_graph
from bayesnet_track.journal.events.beliefs import DegenerateBelief
from bayesnet_track.journal.events.switches import Activated, Deactivated
from bayesnet_track.journal.reader import read_events, read_metrics
from bayesnet_track.journal.text.sentences import explain, why
from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.runtime.recording.rundir import FILES
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource

FRAMES = 41
SQUARES = yaml.safe_load(find_graph("two_squares").read_text())


@pytest.fixture(scope="module")
def scene():
    return make_scene("two_squares", 0)


def graph_with(**beliefs):
    """The graph of the crossing squares with a plate for each belief."""
    graph = {"bayesnet": 1, "name": "conformance", "targets": {}}
    for plate, belief in beliefs.items():
        graph["targets"][plate] = copy.deepcopy(SQUARES["targets"]["square"])
        graph["targets"][plate]["nodes"]["square"]["belief"] = belief
    return GraphSpec.model_validate(graph)


def play(graph, scene, starts, frames=FRAMES, **settings):
    return list(track(graph, SceneSource(scene, "scene:two_squares", frames), starts, **settings))


def boxes_of(results, place=0):
    return np.array([result.targets[place].centre_box for result in results])


@pytest.mark.slow
def test_it_runs_from_pictures_to_files(asked, scene, tmp_path):
    """40 frames of the crossing squares: motion switched off and on by UD and KL, all of it written down."""
    results = play(graph_with(square=asked.says), scene, [Start(scene.start_box)], out=tmp_path / "run")
    events = list(read_events(tmp_path / "run" / FILES["journal"]))
    lines = list(read_metrics(tmp_path / "run" / FILES["frames"]))
    assert {path.name for path in (tmp_path / "run").iterdir()} >= {
        FILES[name] for name in ("journal", "frames", "mot", "timings", "graph")
    }
    assert all(explain(event) for event in events)
    assert any(isinstance(event, Deactivated) and event.node == "motion" for event in events)
    assert not any(isinstance(event, DegenerateBelief) for event in events)
    switched = next(event for event in events if isinstance(event, Deactivated))
    assert "motion" in why(events, lines, switched.frame)
    assert [line.frame for line in lines] == list(range(FRAMES))
    for result, line in zip(results, lines, strict=True):
        (now,) = result.targets
        assert now.centre_box == pytest.approx(line.centre_box, rel=1e-6)
        numbers = [*now.centre_box, *now.sd, now.ud_px2, now.ess, *now.region50, *now.region90]
        assert np.isfinite(numbers).all() and now.particles >= 1
    held = overlap(boxes_of(results), centre_from_corner(scene.truth[:FRAMES]))
    # Before the squares meet.
    assert held[:24].min() > (0.3 if asked.name == "few_particles" else 0.5)
    # Where the squares part again. Sigma points, five places, follow the wrong one in two of four seeds.
    if asked.says.get("gaussian", {}).get("likelihood") != "sigma_points":
        assert held[-5:].min() > 0.5
        assert "gaussian" in asked.says or any(isinstance(event, Activated) for event in events)


def test_the_same_seed_gives_the_same_run(asked, scene):
    graph = graph_with(square=asked.says)
    one, two = (play(graph, scene, [Start(scene.start_box)], 4, seed=3) for _ in range(2))
    for first, second in zip(one, two, strict=True):
        assert first.targets == second.targets


def test_targets_with_beliefs_of_their_own_do_not_touch_each_other(every_belief, scene):
    """Four beliefs in one graph; one of the targets tracked alone: the same figures."""
    chosen = {asked.name: asked.says for asked in every_belief}
    names = ("bootstrap", "adaptive_importance", "gaussian_samples", "grid_of_coarse_cells")
    graph = graph_with(**{name: chosen[name] for name in names})
    other = tuple(float(value) for value in scene.others[0][0])
    starts = [Start(scene.start_box if n % 2 == 0 else other, name) for n, name in enumerate(names)]
    together = play(graph, scene, starts, 12)
    for n, name in enumerate(names):
        path = scene.truth if n % 2 == 0 else scene.others[0]
        assert overlap(boxes_of(together, n), centre_from_corner(path[:12])).min() > 0.5, name
    alone = play(graph, scene, starts[:1], 12)
    for few, many in zip(alone, together, strict=True):
        assert few.targets[0] == many.targets[0]
