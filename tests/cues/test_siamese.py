"""The Siamese cue: what it makes of a network's proposals, how often that runs, and graphs without files."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track import Tracker, load_graph
from bayesnet_track.graph.text.load import GraphError
from bayesnet_track.observation.cue import Hypotheses
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Region
from bayesnet_track.vision.siamese_crops import Memory
from bayesnet_track.vision.siamese_networks import STRIDE, Networks, Response, SiameseError

SIDE = 40.0
GRAPH = """bayesnet: 1
name: network
targets:
  target:
    nodes:
      target: {{motion: {{random_walk: {{sd_box: {{x: 0.1, y: 0.1}}}}}}}}
      network: {{parent: target, agent: {{siamese: {{backbone: {backbone}, head: {head}}}}}}}
"""


def describe(crop):
    return np.zeros(0, np.float32)


def compare(template, crop, size):
    """Cells brighter than half are the target, of the size that is expected."""
    centres = np.clip((np.arange(16) - 8) * STRIDE + 127, 0, 254)
    probabilities = np.where(crop[np.ix_(centres, centres)].mean(axis=2) > 127, 0.99, 0.001)
    sides = np.empty((4, 16, 16), np.float32)
    sides[:] = np.tile(size / 2, 2)[:, None, None]
    return Response(probabilities.astype(np.float32), sides, STRIDE)


@pytest.fixture
def asked(ask):
    """The cue with a network that knows bright from dark."""
    found = ask("siamese", max_crops=1)
    object.__setattr__(found.cue, "memory", Memory(Networks(describe, compare)))
    return found


def bright(*centres):
    image = np.zeros((240, 320, 3), np.uint8)
    for x, y in centres:
        image[int(y - SIDE / 2) : int(y + SIDE / 2), int(x - SIDE / 2) : int(x + SIDE / 2)] = 255
    return FramePair(Frame(1, 1.0, image), None)


def box(x, y, w=SIDE, h=SIDE):
    return np.array([x - 0.5, y - 0.5, w, h])


def test_it_finds_the_target_where_it_is_now(asked):
    reference = asked.learn(bright((160, 120)), box(160, 120))
    moved = bright((184, 112))
    boxes = np.array([box(184 + dx, 112 + dy) for dx in range(-40, 41, 4) for dy in range(-40, 41, 4)])
    values = asked.score(moved, boxes, reference)
    mean = np.exp(values) @ boxes[:, :2] / np.exp(values).sum()
    assert np.abs(mean - box(184, 112)[:2]).max() <= 5.0  # cells of the map are 10 px apart
    assert values.max() > -0.5 and values.min() < -5.0


def test_it_prefers_the_size_that_the_network_gives(asked):
    reference, pair = asked.learn(bright((160, 120)), box(160, 120)), bright((160, 120))
    right, wide, large = asked.score(
        pair, np.array([box(160, 120), box(160, 120, w=1.5 * SIDE), box(160, 120, 60, 60)]), reference
    )
    assert right > wide + 1.0 > large + 1.0


def test_two_that_look_alike_are_both_likely_and_the_place_between_them_is_not(asked):
    reference = asked.learn(bright((120, 120)), box(120, 120))
    boxes = np.array([box(120, 120), box(180, 120), box(150, 60)])
    one, other, neither = asked.score(bright((120, 120), (180, 120)), boxes, reference)
    assert min(one, other) > -1.5 and neither < -4.0


def test_nothing_is_likely_where_nothing_looks_alike(asked):
    reference = asked.learn(bright((160, 120)), box(160, 120))
    values = asked.score(bright(), np.array([box(160, 120), box(150, 120)]), reference)
    assert values.max() < np.log(0.01)


def test_one_run_per_frame_and_target_whatever_is_asked(asked, monkeypatch):
    runs = []
    inner = asked.cue.memory._networks
    counting = Networks(inner.describe, lambda *given: runs.append(1) or inner.compare(*given))
    monkeypatch.setattr(asked.cue.memory, "_networks", counting)
    pair = bright((160, 120))
    reference = asked.learn(pair, box(160, 120))
    planes = PlaneCache(pair).planes(asked.cue.needs, Region(0, 0, 320, 240))
    rng = np.random.default_rng(0)
    spread = np.column_stack([rng.normal(160, 60, 300), rng.normal(120, 60, 300), np.full((300, 2), SIDE)])
    first = asked.cue.log_likelihood(planes, Hypotheses(spread), reference)
    assert runs == [1]
    np.testing.assert_array_equal(first, asked.cue.log_likelihood(planes, Hypotheses(spread), reference))
    assert runs == [1]
    asked.score(bright((164, 120)), spread, reference)
    assert runs == [1, 1]


def test_only_place_and_size_are_learnt_anew(ask):
    asked = ask("siamese")
    old = asked.learn(bright((160, 120)), box(160, 120))
    new = asked.learn(bright((100, 100)), box(110, 100, 30, 50))
    between = asked.cue.blend(old, new, 0.03)
    np.testing.assert_array_equal(between["template"], old["template"])
    np.testing.assert_array_equal(between["place"], new["place"])
    np.testing.assert_array_equal(between["size"], new["size"])


def test_a_graph_can_insist_on_files(ask):
    with pytest.raises(SiameseError, match="needs the two ONNX files of a Siamese tracker"):
        ask("siamese", without_files="refuse")


def test_a_graph_is_refused_at_the_line_of_the_agent(tmp_path):
    graph = tmp_path / "network.yaml"
    graph.write_text(GRAPH.format(backbone="none.onnx", head="other.onnx"), encoding="utf-8")
    with pytest.raises(GraphError, match=r"network.yaml:7:\d+: .*backbone: none.onnx: no such model file"):
        load_graph(graph)


def test_the_graph_deep_is_valid_and_starts_with_files_only():
    text = load_graph("deep").text
    assert "siamese" in text
    with pytest.raises(SiameseError, match="backbone: PATH, head: PATH"):
        Tracker("deep").init(bright((160, 120)).current.image, (140, 100, 40, 40))
