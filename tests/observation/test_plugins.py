"""Plug-ins of other packages: found without running them, loaded only where named and allowed."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from bayesnet_track import CueDeclaration, CueParameters, Tracker, track
from bayesnet_track.cli.main import main
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.observation import plugins
from bayesnet_track.observation.cue import installed_cues
from bayesnet_track.observation.detector import installed_detectors
from bayesnet_track.runtime.checkpoints.recipe import Recipe

BOX = (10, 10, 20, 20)
PACKAGE = """
from pathlib import Path

import numpy as np

from bayesnet_track.observation.cue import CueDeclaration, CueParameters
from bayesnet_track.observation.detector import Detections, DetectorDeclaration, DetectorParameters

Path(__file__).with_name("was_run").touch()


class Middle:
    def start(self):
        return {"seen": np.zeros(1)}

    def detect(self, frames, state):
        box = np.array([[frames.current.width / 2, frames.current.height / 2, 20.0, 10.0]])
        return Detections(box, np.ones(1), ("middle",)), {"seen": state["seen"] + 1}


class Flat:
    needs = ()

    def learn(self, planes, box):
        return {"box": box}

    def blend(self, old, new, rate):
        return old

    def log_likelihood(self, planes, hypotheses, reference):
        return np.zeros(len(hypotheses))


MIDDLE = DetectorDeclaration("middle", "The middle.", DetectorParameters, lambda parameters: Middle())
SAME = DetectorDeclaration("motion", "Another one.", DetectorParameters, lambda parameters: Middle())
FLAT = CueDeclaration("flat", "Nothing.", CueParameters, lambda parameters: Flat())
"""

GRAPH = """
bayesnet: 1
name: foreign
targets:
  thing:
    {birth}
    nodes:
      thing: {{motion: {{random_walk: {{sd_px: {{x: 3, y: 3}}}}}}}}
      flat: {{parent: thing, agent: {cue}}}
"""


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Installs a package with these entry points, for this test; returns the mark that it leaves when run."""

    def make(package="other-package", module="other_package", **points):
        about = tmp_path / f"{module}-1.0.dist-info"
        about.mkdir()
        (tmp_path / f"{module}.py").write_text(PACKAGE)
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
        (about / "entry_points.txt").write_text(
            "".join(f"[bayesnet_track.{group}]\n{point}\n" for group, point in points.items())
        )
        monkeypatch.syspath_prepend(str(tmp_path))
        plugins.forget()
        return tmp_path / "was_run"

    yield make
    monkeypatch.undo()
    for module in ("other_package", "second_package"):
        sys.modules.pop(module, None)
    plugins.forget()


@pytest.fixture
def both(install):
    return install(cues="flat = other_package:FLAT", detectors="middle = other_package:MIDDLE")


@pytest.fixture
def graph(tmp_path):
    def write(cue="flat", birth=""):
        path = tmp_path / "foreign.yaml"
        path.write_text(GRAPH.format(cue=cue, birth=birth))
        return str(path)

    return write


@pytest.fixture
def images(tmp_path):
    import cv2

    folder = tmp_path / "img"
    folder.mkdir()
    for name in ("0.png", "1.png"):
        cv2.imwrite(str(folder / name), np.zeros((40, 60, 3), np.uint8))
    return str(folder)


@pytest.mark.slow
def test_looking_runs_nothing(both, graph, capsys):
    assert main(["list"]) == 0
    said = capsys.readouterr().out
    assert "cues of other packages, not loaded" in said and "flat                  other-package" in said
    assert "detectors of other packages, not loaded" in said and "middle                other-package" in said
    assert main(["schema"]) == 0
    assert main(["validate", "general"]) == 0
    assert main(["validate", graph()]) == 3
    assert "flat" not in installed_cues() and "flat" not in installed_cues(["flat"])
    assert not both.exists()


def test_a_graph_that_names_one_says_how_to_allow_it(both, graph, capsys):
    assert main(["validate", graph(birth="birth: {detector: middle}")]) == 3
    said = capsys.readouterr().err
    found = "of the package other-package, which is not allowed to run"
    assert f"cue 'flat' {found}" in said and f"detector 'middle' {found}" in said
    assert "foreign.yaml:6:" in said and "foreign.yaml:9:" in said
    assert "--allow-plugins flat" in said


def test_what_is_allowed_but_not_named_is_not_run(both, graph):
    assert main(["validate", "general", "--allow-plugins", "flat,middle"]) == 0
    assert not both.exists()
    assert main(["validate", graph("intensity"), "--allow-plugins", "flat,middle"]) == 0
    assert not both.exists()


def test_what_is_named_and_allowed_tracks(both, graph, images, tmp_path):
    line = ["run", graph(), "--source", images, "--init", "10,10,20,20", "--out", str(tmp_path / "run")]
    assert main([*line, "--quiet"]) == 3
    assert not both.exists()
    assert main([*line, "--quiet", "--allow-plugins", "flat"]) == 0
    assert both.exists()


def test_they_are_allowed_from_python_too(both, graph, images):
    with pytest.raises(GraphError, match=r"allow_plugins="):
        next(track(graph(), images, BOX))
    with pytest.raises(GraphError):
        Tracker(graph())
    assert not both.exists()
    assert len(list(track(graph(), images, BOX, allow_plugins=["flat"]))) == 2
    plugins.forget()
    assert Tracker(graph(), allow_plugins="flat") is not None


def test_a_run_remembers_them_but_is_data_and_allows_nothing(both, graph, images, tmp_path, capsys):
    run = tmp_path / "run"
    results = track(graph(), images, BOX, out=run, allow_plugins=["flat", "middle"])
    next(results)
    results.close()
    assert Recipe.read(run).options == {"allow_plugins": "flat"}
    plugins.forget()
    both.unlink()
    line = ["what-if", str(run), "--out", str(tmp_path / "other"), "--seed", "3", "--quiet"]
    for again in (["resume", str(run), "--quiet"], line):
        assert main(again) != 0
        assert "--allow-plugins flat" in capsys.readouterr().err
    assert main([*line, "--allow-plugins", "flat"]) == 0
    assert main(["resume", str(run), "--quiet", "--allow-plugins", "flat"]) == 0


def test_a_detector_that_is_named_and_allowed_finds(both, images, capsys):
    line = ["detect", "middle", "--source", images, "--end", "1"]
    assert main(line) == 2
    assert "--allow-plugins middle" in capsys.readouterr().err and not both.exists()
    assert main([*line, "--allow-plugins", "middle"]) == 0
    assert capsys.readouterr().out == "1,-1,20.500,15.500,20.000,10.000,1.000000,-1,-1,-1\n"


def test_a_name_that_no_package_has_is_a_mistake(both, capsys):
    assert main(["validate", "general", "--allow-plugins", "flaht"]) == 2
    assert "no other package has it; there are: flat, middle" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("point", "said"),
    [
        ("other_package:GONE", "has no attribute 'GONE'"),
        ("other_package:Middle", "is a type, not a DetectorDeclaration"),
        ("other_package:SAME", "it calls itself 'motion'"),
    ],
)
def test_a_broken_one_is_left_out_with_a_warning(install, point, said):
    install(detectors=f"middle = {point}")
    plugins.allow(["middle"])
    left_out = "the detector 'middle' of other-package is left out"
    with pytest.warns(RuntimeWarning, match=left_out) as warned:
        found = installed_detectors(["middle"])
    assert said in str(warned[0].message)
    assert "middle" not in found and found["motion"].summary != "Another one."


def test_one_of_a_built_in_name_never_takes_its_place(install):
    mark = install(cues="motion = other_package:FLAT")
    plugins.allow(["motion"])
    assert installed_cues(["motion"])["motion"].summary != "Nothing."
    assert not mark.exists()


def test_of_two_with_one_name_neither_is_run(install, graph, capsys):
    mark = install(cues="flat = other_package:FLAT")
    install("second-package", "second_package", cues="flat = second_package:FLAT")
    assert main(["validate", graph(), "--allow-plugins", "flat"]) == 3
    assert "other-package and second-package both have 'flat'" in capsys.readouterr().err
    assert not mark.exists()


@pytest.mark.parametrize("cost_ms", [0.0, -1.0, float("nan"), float("inf")])
def test_a_cue_without_a_price_is_refused(cost_ms):
    """Rules divide by it."""
    with pytest.raises(ValueError, match=r"'free': cost_ms .* above 0"):
        CueDeclaration("free", "", CueParameters, lambda parameters: None, cost_ms=cost_ms)
