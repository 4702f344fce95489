"""Cues of one's own from a file or a program: what can go wrong, in the words that a user reads."""

from __future__ import annotations

import re
import sys

import cv2
import numpy as np
import pytest

from bayesnet_track import CueDeclaration, Tracker, load_graph, track
from bayesnet_track.cli.main import main
from bayesnet_track.observation import cue_files, plugins
from bayesnet_track.observation.cue import CUE_FILE_MODULE, CueError
from bayesnet_track.observation.cue_files import load_cue_file, own_cues, pack_cue_files, unpack_cue_files
from bayesnet_track.runtime.checkpoints.recipe import Recipe
from bayesnet_track.runtime.checkpoints.resume import ResumeError, resume
from bayesnet_track.runtime.executors import PlacingError

GLANCE = """
from bayesnet_track import CueDeclaration, GrayPlane, box_means, floored

class Glance:
    needs = (GrayPlane(),)

    def learn(self, planes, box):
        return {"gray": box_means(planes, GrayPlane(), box[None], 5, 5)}

    def log_likelihood(self, planes, hypotheses, reference):
        apart = box_means(planes, GrayPlane(), hypotheses.boxes, 5, 5) - reference["gray"]
        return floored(-0.5 * ((apart / 10) ** 2).mean(axis=1))

CUE = CueDeclaration("glance", make=Glance)
"""
GRAPH = """
bayesnet: 1
name: glanced
targets:
  thing:
    nodes:
      thing:
        motion: {{random_walk: {{sd_px: {{x: 3, y: 3}}}}}}
        belief: {{particles: {{size: 50}}}}
        fuse: product
      one: {{parent: thing, agent: {cue}}}
      other: {{parent: thing, agent: intensity}}
"""
BOX = (20, 12, 16, 16)


@pytest.fixture(autouse=True)
def fresh():
    """No test sees what another loaded."""
    yield
    plugins.forget()
    cue_files._loaded.clear()
    for name in [name for name in sys.modules if name.startswith(CUE_FILE_MODULE)]:
        del sys.modules[name]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working directory, with a graph that names `glance`, and images."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "glanced.yaml").write_text(GRAPH.format(cue="glance"))
    (tmp_path / "img").mkdir()
    rng = np.random.default_rng(1)
    image = rng.integers(0, 255, (48, 64, 3), dtype=np.uint8)
    for n in range(6):
        cv2.imwrite(str(tmp_path / "img" / f"{n}.png"), np.roll(image, n, axis=1))
    return tmp_path


def write(folder, text, name="glance.py"):
    (folder / name).write_text(text)
    return name


def run(*more, out="run"):
    start = ",".join(map(str, BOX))
    return main(["run", "glanced.yaml", "--source", "img", "--init", start, "--out", out, "--quiet", *more])


def journal(folder, out="run"):
    return (folder / out / "journal.jsonl").read_text()


BROKEN = {
    "no_file": (None, "glance.py: no such cue file"),
    "not_python": ("def\n", "glance.py:1:4: the cue file is not Python: invalid syntax"),
    "zero": ("a = 1\0\n", r"glance.py(:\d+:\d+)?: the cue file is not Python: source code.*null bytes"),
    "import": (
        "\nimport no_such_library\n",
        "glance.py:2: the cue file cannot be loaded: it raised ModuleNotFoundError: No module named "
        "'no_such_library'",
    ),
    "exit": (
        "\n\nraise SystemExit(7)\n",
        "glance.py:3: the cue file cannot be loaded: it raised SystemExit: 7",
    ),
    "no_cue": (
        "x = 1\n",
        r"glance.py: no CUE in the cue file; needed: CUE = CueDeclaration\(name, make=...\)",
    ),
    "other": (
        "def CUE(): pass\n",
        r"glance.py: CUE in the cue file is a function; needed: CUE = CueDeclaration\(name, make=...\)",
    ),
    "built_in": (
        GLANCE.replace('"glance"', '"motion"'),
        "glance.py: the cue 'motion' has the name of a built-in cue; give it another name",
    ),
    "no_make": (
        "from bayesnet_track import CueDeclaration\nCUE = CueDeclaration('glance')\n",
        "glance.py:2: the cue file cannot be loaded: it raised ValueError: cue 'glance': no `make`: a class, "
        "or a function that makes the cue",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_file_that_is_no_cue_is_told_by_its_line(folder, capsys, case):
    text, message = BROKEN[case]
    if text is not None:
        write(folder, text)
    before = set(sys.modules)
    assert main(["validate", "glanced.yaml", "--cue-file", "glance.py"]) == 2
    said = capsys.readouterr().err
    assert re.fullmatch(f"bayesnet-track validate: {message}\n", said), said
    left = [name for name in sys.modules.keys() - before if name.startswith(CUE_FILE_MODULE)]
    assert len(left) == (case == "built_in")


def test_a_folder_is_no_cue_file(folder, capsys):
    assert main(["list", "--cue-file", "img"]) == 2
    assert capsys.readouterr().err == (
        "bayesnet-track list: img: the cue file cannot be read: Is a directory\n"
    )


def test_two_files_with_one_name_are_refused(folder, capsys):
    first, second = write(folder, GLANCE), write(folder, GLANCE + "\n", "second.py")
    assert main(["list", "--cue-file", first, "--cue-file", second]) == 2
    assert capsys.readouterr().err == (
        "bayesnet-track list: second.py: the cue 'glance' has the name of the cue of glance.py; "
        "give it another name\n"
    )


def test_a_graph_that_names_an_unknown_cue_says_where_and_which_there_are(folder, capsys):
    write(folder, GLANCE)
    (folder / "glanced.yaml").write_text(GRAPH.format(cue="glanse"))
    assert main(["validate", "glanced.yaml", "--cue-file", "glance.py"]) == 3
    said = capsys.readouterr().err
    assert said.startswith("glanced.yaml:11:35: one: unknown cue 'glanse'; allowed: ")
    assert "; nearest: glance\n" in said


FLAGS = 'CUE = CueDeclaration("glance", make=Glance, adapts=True)'


def test_a_flag_without_a_method_is_told_before_a_frame_is_tracked(folder, capsys):
    write(folder, GLANCE.replace('CUE = CueDeclaration("glance", make=Glance)', FLAGS))
    assert run("--cue-file", "glance.py") == 2
    assert capsys.readouterr().err == (
        "bayesnet-track run: cue 'glance' declares adapts=True and has no method 'adapt': "
        "write it, or remove the flag\n"
    )
    assert not (folder / "run").exists()
    plugins.forget()
    assert main(["graph", "glanced.yaml", "--cue-file", "glance.py"]) == 2
    assert capsys.readouterr().err.startswith("bayesnet-track graph: cue 'glance' declares adapts=True")


WRONG_ANSWERS = {
    "shape": ("return np.zeros((2, 3))", "returned an array of shape (2, 3) for 50 hypotheses"),
    "nan": (
        "return np.full(len(hypotheses), np.nan)",
        "returned a log-likelihood of nan, not at most 0, for 50 of 50 hypotheses",
    ),
    "raises": ("return 1 / 0", "raised ZeroDivisionError: division by zero (glance.py:13)"),
}


@pytest.mark.parametrize("case", WRONG_ANSWERS)
def test_a_wrong_answer_stops_that_agent_and_the_run_goes_on(folder, case):
    wrong, message = WRONG_ANSWERS[case]
    write(folder, "import numpy as np\n" + re.sub(r"return floored.*", wrong, GLANCE))
    assert run("--cue-file", "glance.py") == 0
    faults = [line for line in journal(folder).splitlines() if "quarantined" in line]
    assert faults and message in faults[0], journal(folder)


def test_a_cue_file_is_recorded_and_needed_to_resume(folder, capsys):
    write(folder, GLANCE)
    results = track("glanced.yaml", "img", BOX, out="run", cues=["glance.py"], checkpoint_every=1e-9)
    for _ in range(4):
        next(results)
    results.close()
    was = Recipe.read("run").cue_files["glance"]
    assert was.path == "glance.py" and was.absolute == str(folder / "glance.py")
    digest = was.sha256[:12]

    def refused(*cues):
        with pytest.raises(ResumeError) as raised:
            list(resume("run", cues=cues))
        return str(raised.value)

    assert refused() == (
        f"its cue 'glance' is the code in glance.py (SHA-256 {digest}), which is run only when it is named: "
        "cues=['glance.py']"
    )
    (folder / "glance.py").write_text(GLANCE.replace("/ 10", "/ 11"))
    assert re.fullmatch(
        rf"glance.py: SHA-256 \w{{12}}; its cue 'glance' was glance.py with {digest}: "
        "give that file as it was",
        refused("glance.py"),
    )
    assert main(["resume", "run", "--quiet", "--cue-file", "glance.py"]) == 4
    assert capsys.readouterr().err.startswith("bayesnet-track resume: glance.py: SHA-256 ")
    plugins.forget()
    (folder / "moved.py").write_text(GLANCE)
    assert len(list(resume("run", cues=["moved.py"]))) == 2
    whole = list(track("glanced.yaml", "img", BOX, out="whole", cues=["moved.py"]))
    assert len(whole) == 6 and journal(folder) == journal(folder, "whole")


def test_what_if_asks_for_the_file_too(folder, capsys):
    write(folder, GLANCE)
    assert run("--cue-file", "glance.py") == 0
    plugins.forget()
    assert main(["report", "run"]) == 0  # shows the net, and runs no code
    assert "shows no net" not in capsys.readouterr().err
    again = ["what-if", "run", "--seed", "1", "--quiet"]
    assert main(again) == 4
    assert "bayesnet-track what-if: its cue 'glance' is the code in glance.py" in capsys.readouterr().err
    assert main([*again, "--cue-file", "glance.py"]) == 0
    assert Recipe.read("run-what-if").cue_files["glance"].path == "glance.py"


def test_cues_of_a_program_belong_to_one_tracker():
    def bright(level):
        class Constant:
            needs = ()

            def learn(self, planes, box):
                return {"level": np.array(level)}

            def log_likelihood(self, planes, hypotheses, reference):
                return np.full(len(hypotheses), -float(reference["level"]))

        return CueDeclaration("constant", make=Constant)

    graph = {"name": "own", "targets": {"thing": {"nodes": {
        "thing": {"motion": {"random_walk": {"sd_px": {"x": 3, "y": 3}}}},
        "one": {"parent": "thing", "agent": "constant"},
    }}}}  # fmt: skip
    frame = np.zeros((48, 64, 3), np.uint8)
    for level in (1.0, 2.0):
        tracker = Tracker(graph, cues=[bright(level)])
        tracker.init(frame, BOX)
        assert tracker.update(frame)[0] is not None
        assert float(tracker._now.state.targets["1"].references["one"]["level"]) == level
    checked = load_graph(graph, [bright(3.0)])
    Tracker(checked).init(frame, BOX)  # a checked graph keeps its cues
    assert list(checked.cues) == ["constant"]


def test_a_run_with_a_cue_of_a_program_says_so(folder):
    cue = load_cue_file(write(folder, GLANCE)).declaration
    cue_files._loaded.clear()  # as if it were an object of a program
    list(track("glanced.yaml", "img", BOX, out="run", cues=[cue]))
    recipe = Recipe.read("run")
    assert recipe.own_cues == ("glance",) and not recipe.cue_files
    assert recipe.only_once == "it was tracked with cues of a program of one's own: glance"


@pytest.mark.slow
def test_worker_processes_run_the_file_as_it_was_when_the_run_began(folder):
    write(folder, GLANCE)
    results = track("glanced.yaml", "img", BOX, out="workers", cues=["glance.py"], executor="processes")
    next(results)
    (folder / "glance.py").write_text("changed")
    list(results)
    (folder / "glance.py").write_text(GLANCE)
    list(track("glanced.yaml", "img", BOX, out="serial", cues=["glance.py"]))
    assert journal(folder, "workers") == journal(folder, "serial")


def test_a_cue_of_the_program_that_runs_cannot_be_in_a_worker_process(folder, monkeypatch):
    declaration = load_cue_file(write(folder, GLANCE)).declaration
    made = declaration.make.make
    monkeypatch.setattr(made, "__module__", "__main__")
    monkeypatch.setattr(sys.modules["__main__"], "Glance", made, raising=False)
    with pytest.raises(PlacingError) as raised:
        next(track("glanced.yaml", "img", BOX, cues=[declaration], executor="processes"))
    assert str(raised.value) == (
        "agent thing.one cannot be in a process: its cue is defined in the program that runs, which workers "
        "do not import; put it into a file of its own, and give its path: cues=['my_cue.py']"
    )


def test_what_is_no_cue_is_refused():
    with pytest.raises(CueError, match=r"cues: int; allowed: a CueDeclaration, or the path of a cue file"):
        own_cues([3])


def test_a_worker_process_loads_the_same_bytes(folder):
    first = load_cue_file(write(folder, GLANCE))
    content = pack_cue_files()
    (folder / "glance.py").write_text("changed")
    cue_files._loaded.clear()
    unpack_cue_files(content)
    (again,) = cue_files._loaded.values()
    assert again.content == first.content and again.declaration.name == "glance"
    cue_files._loaded.clear()
    assert pack_cue_files() == b""
    unpack_cue_files(b"")


class LearnsNothing:
    """A cue that prefers the left half and needs no reference."""

    needs = ()

    def learn(self, planes, box):
        return {}

    def log_likelihood(self, planes, hypotheses, reference):
        assert reference == {}
        return -0.001 * (hypotheses.boxes[:, 0] - 28.0) ** 2


def test_a_cue_with_an_empty_reference_is_a_cue_like_any_other(tmp_path):
    """Alone and beside another agent."""
    cue = CueDeclaration("nothing", make=LearnsNothing)
    rng = np.random.default_rng(0)
    frames = [rng.integers(0, 255, (64, 96), dtype=np.uint8) for _ in range(4)]
    whole = GRAPH.format(cue="nothing")
    path = tmp_path / "graph.yaml"
    for text in (whole, "\n".join(whole.splitlines()[:-1])):
        path.write_text(text)
        tracker = Tracker(str(path), cues=[cue])
        tracker.init(frames[0], BOX)
        assert all(tracker.update(frame)[1] is not None for frame in frames[1:])
