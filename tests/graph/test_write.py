"""YAML and Python say the same graph: writing and reading lose nothing."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bayesnet_track import GraphSpec
from bayesnet_track.graph.rules.agent_rule import AgentRule
from bayesnet_track.graph.settings.base import PluginChoice
from bayesnet_track.graph.settings.motion import OnGround
from bayesnet_track.graph.settings.queries import CrossingLine
from bayesnet_track.graph.spec import AgentChoice, Choice, Fuse, Model, Motion, Moving, Noise
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.graph.text.write import as_plain, graph_sha256, write_graph

LENIENT = settings(max_examples=50, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))


@pytest.mark.slow
@LENIENT
@given(data=st.data())
def test_reading_what_was_written_gives_the_same_graph(specs, data):
    spec = data.draw(specs)
    text = write_graph(spec)
    again, at = read_graph(text)
    assert again == spec
    assert write_graph(again) == text
    assert ("name",) in at.keys


@pytest.mark.slow
@LENIENT
@given(data=st.data())
def test_the_plain_form_means_the_same(graphs, data):
    spec = GraphSpec.model_validate(data.draw(graphs))
    assert GraphSpec.model_validate(as_plain(spec)) == spec


@settings(max_examples=50, deadline=None, derandomize=True)
@given(st.text(st.characters(exclude_categories=["Cs"]), max_size=60))
def test_any_text_survives(about):
    spec = GraphSpec.model_validate({"name": "g", "about": about, "targets": {"t": {"nodes": {"t": {}}}}})
    assert read_graph(write_graph(spec).encode())[0].about == about


@settings(max_examples=50, deadline=None, derandomize=True)
@given(st.floats(min_value=0, allow_nan=False, allow_infinity=False))
def test_floats_survive_bit_for_bit(sd):
    node = {"motion": {"random_walk": {"sd_px": {"x": sd}}}}
    spec = GraphSpec.model_validate({"name": "g", "targets": {"t": {"nodes": {"t": node}}}})
    again = read_graph(write_graph(spec))[0].targets["t"].nodes["t"].motion.random_walk.sd_px.x
    assert again.hex() == float(sd).hex() or again == sd == 0


def test_every_part_of_the_language_survives(everything):
    spec = GraphSpec.model_validate(everything)
    assert read_graph(write_graph(spec))[0] == spec
    bases = {AgentRule, Choice, CrossingLine, PluginChoice, Moving, Noise, OnGround}
    assert _subclasses(Model) - set(_models_in(spec)) == bases


def _models_in(value):
    if isinstance(value, Model):
        yield type(value)
        for name in type(value).model_fields:
            yield from _models_in(getattr(value, name))
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else ()
    for inside in inner:
        yield from _models_in(inside)


def _subclasses(base):
    return set(base.__subclasses__()).union(*(_subclasses(model) for model in base.__subclasses__()))


def test_choices_take_their_short_form():
    assert as_plain(Fuse.model_validate({"pool": "equal"})) == "pool"
    assert as_plain(Fuse.model_validate({"product": {}})) == "product"
    assert as_plain(Motion.model_validate({"random_walk": {"sd_px": {"x": 20.0}}})) == {
        "random_walk": {"sd_px": {"x": 20}}
    }
    assert as_plain(AgentChoice(cue="motion")) == "motion"
    assert as_plain(AgentChoice(cue="hue", parameters={"window": (3, 3)})) == {"hue": {"window": [3, 3]}}


def test_the_digest_is_of_the_text():
    assert graph_sha256("") == "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
