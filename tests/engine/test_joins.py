"""Joined targets through the engine: a carried box, identities in a crowd, what is told, and replay."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track import Start, load_graph
from bayesnet_track.engine.starts import start_targets
from bayesnet_track.engine.step import first_look, make_engine, step
from bayesnet_track.graph.checks.run import check, check_graph
from bayesnet_track.graph.text.write import as_plain
from bayesnet_track.journal.codec import from_json, to_json
from bayesnet_track.journal.events.faults import PairFactorChanged
from bayesnet_track.journal.events.joins import AttachmentChanged, Joined, OcclusionChanged, Parted
from bayesnet_track.journal.net import Decision, replay
from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.people import BEHIND, carried_box
from bayesnet_track.sources.scenes.shapes import crowd, orange_and_gray

FEW = 18
"""Frames in which some of the crowd meet."""


def tracked(scene, graph, seed, frames=None):
    """The outcomes of every frame."""
    engine = make_engine(graph, seed)
    state, outcomes = None, []
    for index in range(frames or len(scene.frames)):
        frame = Frame(index, float(index), scene.frames[index], True, float(index))
        if state is None:
            starts = [Start(box, plate) for plate, box in scene.starts]
            outcome = first_look(engine, start_targets(graph, engine, frame, starts), frame)
        else:
            outcome = step(engine, state, frame)
        state = outcome.state
        outcomes.append(outcome)
    return outcomes


def alone(graph):
    return check(graph.spec.model_copy(update={"joins": ()}))


def hidden_error(scene, outcomes):
    hidden = np.flatnonzero(scene.visible == 0)
    true = centre_from_corner(scene.truth)
    found = np.array([outcomes[index].metrics[0].centre_box[:2] for index in hidden])
    return float(np.median(np.linalg.norm(found - true[hidden, :2], axis=1)))


@pytest.fixture(scope="module")
def carried():
    scene = carried_box(2)
    return scene, tracked(scene, load_graph("carried_box"), 2)


@pytest.mark.slow
def test_a_carried_box_is_joined_hidden_found_and_parted(carried):
    scene, outcomes = carried
    events = [event for outcome in outcomes for event in outcome.events]
    joins = [event for event in events if isinstance(event, Joined | Parted)]
    assert [type(event) for event in joins] == [Joined, Parted]
    assert (joins[0].target, joins[0].other, joins[0].kinds) == ("2", "1", ("person", "box"))
    hidden = [event for event in events if isinstance(event, OcclusionChanged)]
    assert [(event.target, event.other, event.hidden) for event in hidden] == [
        ("1", "2", True),
        ("1", "2", False),
    ]
    carrying = [event for event in events if isinstance(event, AttachmentChanged)]
    assert carrying[0].attached and (carrying[0].target, carrying[0].other) == ("1", "2")
    assert hidden_error(scene, outcomes) < 10
    end = np.array(outcomes[-1].metrics[0].centre_box[:2])
    assert np.linalg.norm(end - centre_from_corner(scene.truth)[-1, :2]) < 5


@pytest.mark.slow
def test_it_learns_nothing_while_it_is_hidden_and_is_not_lost_for_it(carried):
    _, outcomes = carried
    for outcome in outcomes[BEHIND + 4 : BEHIND + 30]:
        box = outcome.metrics[0]
        assert box.join is not None and box.join.hidden > 0.5 and box.join.behind == "2"
        assert box.learn_rate == 0
        assert 0 <= box.join.attached <= 1
        again = from_json(to_json(box)).join
        assert again.hidden == pytest.approx(box.join.hidden) and again.others == ("2",)


@pytest.mark.slow
def test_decisions_rebuild_which_targets_are_joined(carried):
    _, outcomes = carried
    decisions = [event for outcome in outcomes for event in outcome.events if isinstance(event, Decision)]
    for index in (0, 40, 80, len(outcomes) - 1):
        assert replay(decisions, until_frame=index + 1).joins == outcomes[index].state.net.joins


@pytest.mark.slow
def test_states_keep_their_fields_and_a_graph_without_joins_says_nothing_of_them(carried):
    scene, outcomes = carried
    assert outcomes[70].state.targets["1"].belief.fields == ("x", "y", "w", "h")
    plain = tracked(scene, alone(load_graph("carried_box")), 2, frames=45)
    assert all("join" not in to_json(metrics) for outcome in plain for metrics in outcome.metrics)
    # Until they are joined, the graph with joins gives the same bytes.
    for before, other in zip(outcomes[:20], plain[:20], strict=True):
        assert [to_json(one) for one in before.metrics] == [to_json(one) for one in other.metrics]


@pytest.mark.slow
def test_joins_halve_the_error_of_a_hidden_box_over_seeds():
    """Of 20 seeds the median error with joins is at most half of that without."""
    graph = load_graph("carried_box")
    found = []
    for seed in range(20):
        scene = carried_box(seed)
        found.append([hidden_error(scene, tracked(scene, one, seed)) for one in (graph, alone(graph))])
    joined, independent = np.median(found, axis=0)
    assert joined <= independent / 2


@pytest.mark.slow
def test_fewer_nets_end_on_another_target_in_a_crowd():
    """Nets that are nearest to another disc at the end: at most half as many, of a crowd of fifty."""
    graph = load_graph("crowd")
    astray = np.zeros(2)
    scene = crowd(0, 50, 100)
    true = centre_from_corner(np.array([scene.truth, *scene.others]))[:, -1, :2]
    for number, one in enumerate((graph, alone(graph))):
        boxes = np.array([metrics.centre_box[:2] for metrics in tracked(scene, one, 0)[-1].metrics])
        held = np.argmin(np.linalg.norm(boxes[:, None] - true[None], axis=2), axis=1)
        astray[number] = np.sum(held != np.arange(len(true)))
    assert astray[1] > 0
    assert astray[0] <= astray[1] / 2


@pytest.mark.parametrize("name", ["carried_box", "crowd"])
def test_scenes_are_whole(name):
    scene = make_scene(name, 3)
    assert len(scene.starts) == len(scene.plates)
    if name == "carried_box":
        assert scene.visible.min() == 0 and scene.visible[[0, -1]].tolist() == [1, 1]
        assert np.flatnonzero(scene.visible == 0).tolist()[0] == pytest.approx(BEHIND, abs=6)
        assert scene.truth[:, 0].min() >= 0 and (scene.truth[:, 0] + 28).max() <= scene.width
    else:
        assert scene.truth[:, :2].min() >= -1e-9
        assert (scene.truth[:, :2] + scene.truth[:, 2:] <= [scene.width, scene.height]).all()


@pytest.mark.slow
def test_a_factor_that_is_the_same_everywhere_changes_no_joint_belief():
    """It belongs to the prior of each: taken for evidence of pixels it would change the shares that match."""
    scene, plain = crowd(1, count=16), as_plain(load_graph("crowd").spec)
    (kind,) = plain["targets"]
    root = next(name for name, node in plain["targets"][kind]["nodes"].items() if "parent" not in node)
    plain["targets"][kind]["nodes"][root]["belief"] = {"particles": {"size": 60}}
    without = tracked(scene, check_graph(plain), 3, FEW)
    plain["targets"][kind]["nodes"]["same"] = {"parent": root, "factor": "exp(-9)"}
    outcomes = tracked(scene, check_graph(plain), 3, FEW)
    assert any(outcome.state.net.joins for outcome in outcomes)
    for one, other in zip(outcomes, without, strict=True):
        for own, before in zip(one.metrics, other.metrics, strict=True):
            assert own.centre_box == pytest.approx(before.centre_box, abs=1e-6)
            assert own.ud_px2 == pytest.approx(before.ud_px2, rel=1e-6)
            assert (own.join is None) == (before.join is None)
            if own.join is not None and before.join is not None:
                assert own.join.hidden == pytest.approx(before.join.hidden, abs=1e-6)


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        ("where(a.x > 9 * frame_width, 1, 0)", [(1, False, True)]),
        ("sqrt(b.x - a.x)", [(1, True, True)]),
        ("where(a.x < 1000, 1, 0)", []),
    ],
)
def test_a_factor_of_two_targets_that_leaves_no_pair_is_an_event(factor, said):
    scene = orange_and_gray(0, frames=25)
    plain = as_plain(load_graph("orange_and_gray").spec)
    join = {"between": ["orange", "gray"], "factor": factor, "when": {"overlap": 0}}
    outcomes = tracked(scene, check_graph({**plain, "joins": [join]}), 0, 5)
    events = [one for outcome in outcomes for one in outcome.events if isinstance(one, PairFactorChanged)]
    assert [(len(events), one.undefined > 0, one.ignored) for one in events] == said


@pytest.mark.parametrize(
    ("factor", "pulls"),
    [
        ("1", False),
        ("normal(b.x - a.x, -195, 3)", True),
        pytest.param("normal(b.x - a.x, -100, 0.5)", True, id="beyond the smallest number"),
    ],
)
def test_a_factor_of_two_targets_pulls_them_however_far_they_are(factor, pulls):
    """An orange and a gray square, 220 px apart; the spring's length is 195 px."""
    scene = orange_and_gray(0, frames=25)
    plain = as_plain(load_graph("orange_and_gray").spec)
    apart = tracked(scene, check_graph(plain), 0, 3)
    join = {"between": ["orange", "gray"], "factor": factor, "pairings": 64, "when": {"overlap": 0}}
    joined = tracked(scene, check_graph({**plain, "joins": [join]}), 0, 3)
    events = [event for outcome in joined for event in outcome.events if isinstance(event, Joined)]
    assert [(event.kinds, event.overlap) for event in events] == [(("orange", "gray"), 0.0)]

    def gap(outcome):
        boxes = {name: state.belief.mean for name, state in outcome.state.targets.items()}
        return boxes["2"][0] - boxes["1"][0]

    before, after = gap(apart[-1]), gap(joined[-1])
    assert before < -197
    assert after > before + 0.5 if pulls else abs(after - before) < 1.5
