"""What a declaration says of a cue is what the cue can do; what it leaves out is filled in."""

from __future__ import annotations

import pickle
from dataclasses import dataclass

import numpy as np
import pytest
from pydantic import Field

from bayesnet_track import CueDeclaration, CueParameters
from bayesnet_track.observation.cue import METHODS, CueError, Making, blend_arrays, installed_cues, make_cue
from bayesnet_track.observation.protocols import Cue


class Plain:
    """The least that a cue can be."""

    needs = ()

    def learn(self, planes, box):
        return {"box": box}

    def log_likelihood(self, planes, hypotheses, reference):
        return np.zeros(len(hypotheses))


class Measures:
    needs = ()

    def learn(self, planes, box):
        return {"box": box}

    def measure(self, planes, hypotheses, weights, reference):
        return None


def with_method(base, method):
    return type("Own", (base,), {method: lambda self, *arguments: None})


class Parameters(CueParameters):
    sd: float = Field(default=2.0, gt=0, description="Some sd (px).")


@dataclass(frozen=True)
class Parametrised(Plain):
    parameters: Parameters


def test_the_least_declaration_is_a_name_and_a_class():
    declaration = CueDeclaration("plain", make=Plain)
    cue = make_cue(declaration, declaration.parameters())
    assert isinstance(cue, Cue) and cue.blend is blend_arrays and cue.learn(None, 3) == {"box": 3}
    assert declaration.parameters.model_fields == {}
    assert pickle.loads(pickle.dumps(declaration)) == declaration


def test_a_cue_with_parameters_is_made_of_them_and_a_frozen_one_blends_too():
    declaration = CueDeclaration("own", parameters=Parameters, make=Parametrised)
    cue = make_cue(declaration, Parameters(sd=3))
    assert cue.parameters.sd == 3.0
    assert cue.blend({"a": np.array(0.0)}, {"a": np.array(1.0)}, 0.25)["a"] == 0.25


def test_a_blend_of_its_own_stays():
    class Own(Plain):
        def blend(self, old, new, rate):
            return old

    assert make_cue(CueDeclaration("own", make=Own), None).blend(1, 2, 0.5) == 1


@pytest.mark.parametrize("name", sorted(installed_cues()))
def test_every_built_in_cue_is_what_it_declares(name):
    declaration = installed_cues()[name]
    assert isinstance(declaration.make, Making)
    if declaration.missing is None or declaration.missing(declaration.parameters()) is None:
        make_cue(declaration, declaration.parameters())


@pytest.mark.parametrize("flag", METHODS)
def test_a_flag_without_its_method_names_cue_flag_and_method(flag):
    base = Measures if flag == "reads_detection" else Plain
    settings = {flag: True, **({"measures": True} if base is Measures else {})}
    if flag == "measures":
        base = type("Neither", (), {"needs": (), "learn": Plain.learn})
    with pytest.raises(CueError) as raised:
        make_cue(CueDeclaration("half", make=base, **settings), None)
    method = METHODS[flag]
    assert str(raised.value) == (
        f"cue 'half' declares {flag}=True and has no method {method!r}: write it, or remove the flag"
    )


@pytest.mark.parametrize("flag", METHODS)
def test_a_method_without_its_flag_names_cue_flag_and_method(flag):
    base = Measures if flag == "measures" else with_method(Plain, METHODS[flag])
    with pytest.raises(CueError) as raised:
        make_cue(CueDeclaration("more", make=base), None)
    assert str(raised.value) == (
        f"cue 'more' has the method {METHODS[flag]!r} and does not declare {flag}=True: "
        "add the flag to its CueDeclaration, or rename the method"
    )


def test_a_cue_that_measures_and_scores_is_refused():
    declaration = CueDeclaration("both", make=with_method(Plain, "measure"), measures=True)
    with pytest.raises(CueError, match="either measures or scores"):
        make_cue(declaration, None)


def test_what_every_cue_needs_is_named():
    with pytest.raises(CueError) as raised:
        make_cue(CueDeclaration("empty", make=object), None)
    said = str(raised.value).splitlines()
    assert [line.split("'")[3] for line in said] == ["needs", "learn", "blend", "log_likelihood"]


def test_what_make_raises_is_shown():
    def fails(parameters):
        raise OSError("no such model")

    with pytest.raises(CueError, match=r"cue 'broken' cannot be made: it raised OSError: no such model"):
        make_cue(CueDeclaration("broken", parameters=CueParameters, make=fails), None)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"name": "a b", "make": Plain}, "cue 'a b': a name of letters, digits and _ is needed"),
        ({"name": "", "make": Plain}, "cue '': a name"),
        ({"name": "plain"}, "cue 'plain': no `make`"),
        ({"name": "plain", "make": Plain()}, "cue 'plain': no `make`"),
    ],
)
def test_a_declaration_without_name_or_make_is_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        CueDeclaration(**settings)
