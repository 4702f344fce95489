"""The JSON Schema accepts what the specification accepts, as far as structure goes."""

from __future__ import annotations

import copy
import json

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from jsonschema import Draft7Validator
from pydantic import ValidationError

from bayesnet_track import GraphSpec
from bayesnet_track.graph.checks.cues import cue_parameters, plugin_parameters
from bayesnet_track.graph.text.document import read_document
from bayesnet_track.graph.text.write import graph_schema
from bayesnet_track.graphs import find_graph, graph_names
from bayesnet_track.observation.detector import detectors_of_graphs

LENIENT = settings(max_examples=50, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))


@pytest.fixture(scope="module")
def validator(cues):
    return Draft7Validator(graph_schema(cues))


def _well_formed(data, cues):
    """Whether the specification and the cues' own types accept the data."""
    try:
        spec = GraphSpec.model_validate(data)
        for target in spec.targets.values():
            for _, _, chosen in target.cue_choices():
                cue_parameters(chosen, cues[chosen.cue])
            if target.birth is not None:
                chosen = target.birth.detector
                plugin_parameters(chosen, detectors_of_graphs()[chosen.detector].parameters)
    except (ValidationError, KeyError):
        return False
    return True


def test_it_is_draft_07(cues):
    schema = graph_schema(cues)
    assert schema["$schema"] == "http://json-schema.org/draft-07/schema#"
    Draft7Validator.check_schema(schema)
    later = ("$defs", "unevaluatedProperties", "prefixItems", "dependentRequired", "discriminator")
    assert not [word for word in later if f'"{word}"' in json.dumps(schema)]


def test_references_have_no_siblings_and_all_lead_somewhere(cues):
    schema = graph_schema(cues)

    def visit(part):
        if isinstance(part, dict):
            if isinstance(part.get("$ref"), str):
                assert len(part) == 1
                assert part["$ref"].removeprefix("#/definitions/") in schema["definitions"]
            for inside in part.values():
                visit(inside)
        for inside in part if isinstance(part, list) else ():
            visit(inside)

    visit(schema)


@pytest.mark.slow
@pytest.mark.parametrize("name", graph_names())
def test_every_installed_graph_is_valid(name):
    graph = find_graph(name)
    assert (
        list(Draft7Validator(graph_schema()).iter_errors(read_document(graph.read_bytes(), name).value)) == []
    )


def test_the_whole_language_is_valid(validator, everything):
    assert list(validator.iter_errors(everything)) == []


@LENIENT
@given(data=st.data())
def test_generated_graphs_are_valid(validator, graphs, cues, data):
    graph = data.draw(graphs)
    assert _well_formed(graph, cues)
    validator.validate(graph)


@LENIENT
@given(data=st.data())
def test_both_judge_a_changed_graph_alike(validator, everything, cues, data):
    graph = copy.deepcopy(everything)
    place = data.draw(st.sampled_from(sorted(_places(graph), key=repr)), label="place")
    strange = st.sampled_from(
        [-1, 0.5, "pool", "random_walk", "no", True, [], {}, {"x": 1}, ["x", "q"], 10**9]
    )
    *above, last = place
    inside = graph
    for key in above:
        inside = inside[key]
    if data.draw(st.booleans(), label="replace"):
        inside[last] = data.draw(strange, label="value")
    elif isinstance(inside, dict):
        inside["strange"] = inside.pop(last)
    assert validator.is_valid(graph) == _well_formed(graph, cues)


def _places(value, path=()):
    if path:
        yield path
    if isinstance(value, dict):
        for key, inside in value.items():
            yield from _places(inside, (*path, key))
    elif isinstance(value, list):
        for index, inside in enumerate(value):
            yield from _places(inside, (*path, index))


BROKEN = {
    "unknown key": ("a", {"activte": {}}),
    "unknown word": ("a", {"fuse": "prodct"}),
    "two choices": ("a", {"fuse": {"product": {}, "pool": "equal"}}),
    "word that needs settings": ("a", {"fuse": "latent"}),
    "number out of range": ("a", {"adapt": {"keep": 0}}),
    "unknown cue": ("e", {"agent": "motoin"}),
    "parameter of the wrong type": ("e", {"agent": {"hue": {"bins": "many"}}}),
    "parameter out of range": ("e", {"agent": {"hue": {"bins": 2}}}),
    "unknown parameter": ("e", {"agent": {"hue": {"bin": 32}}}),
    "bare word of a cue that needs a parameter": ("e", {"agent": "needy"}),
    "two parents": ("e", {"parent": ["c", "a"]}),
    "nothing": ("a", {"fuse": None}),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_graphs_are_not_valid(validator, everything, case):
    node, change = BROKEN[case]
    graph = copy.deepcopy(everything)
    graph["targets"]["t"]["nodes"][node].update(change)
    assert not validator.is_valid(graph)


def test_editors_find_cues_and_parameters_described(cues):
    definitions = graph_schema(cues)["definitions"]
    assert {"const": "motion", "description": "Flow."} in definitions["AgentChoice"]["anyOf"]
    assert definitions["cue_hue"]["properties"]["bins"]["description"] == "bins round the hue circle, count"
