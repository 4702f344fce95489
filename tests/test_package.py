"""The package from outside: what is in the wheel, what imports cost, and cues of other packages."""

import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track import load_graph, open_run
from bayesnet_track.cli.main import main
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.observation import plugins
from bayesnet_track.observation.cue import installed_cues

ROOT = Path(__file__).parents[1]
BUILT_IN = sorted(file.stem for file in (ROOT / "cues").glob("[a-z]*.py"))
"""Every file of the folder is a cue, and none may be left unregistered."""


def python(*arguments, **settings):
    return subprocess.run([sys.executable, *map(str, arguments)], capture_output=True, text=True, **settings)


# ------------------------------------------------------------------------------------ imports

HEAVY = {"cv2", "av", "numba", "scipy", "matplotlib"}
LIGHT = [
    "import bayesnet_track.sources.sources",
    "import bayesnet_track.evaluate.runs",
    "from bayesnet_track.journal import reader, writer; from bayesnet_track.journal.text import sentences",
    "from bayesnet_track.observation.cue import installed_cues; installed_cues()",
    "from bayesnet_track.cli.main import main; main(['validate', 'general', 'two_squares'])",
    "from bayesnet_track.cli.main import main; main(['list'])",
    "from bayesnet_track.cli.main import main; main(['schema'])",
    "from bayesnet_track.cli.main import main; main(['graph', 'general', '--formula'])",
]
LIGHTEST = [
    "import bayesnet_track",
    "from bayesnet_track.cli.main import main, make_parser; make_parser().format_help()",
    "from bayesnet_track.cli.main import main; main(['--version'])",
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("steps", "absent"), [(LIGHTEST, HEAVY | {"numpy", "pydantic", "yaml"}), (LIGHT, HEAVY)]
)
def test_what_is_heavy_is_not_imported(steps, absent):
    code = "".join(
        f"{step}\nimport sys; print('after', sorted(set(sys.modules) & {absent!r}), {step!r})\n"
        for step in steps
    )
    lines = [line for line in python("-c", code, check=True).stdout.splitlines() if line.startswith("after ")]
    assert lines == [f"after [] {step}" for step in steps]


def test_the_command_and_the_module_are_the_same():
    module = python("-m", "bayesnet_track", "--help", check=True).stdout
    assert module.startswith("usage: bayesnet-track ")
    command = shutil.which("bayesnet-track", path=str(Path(sys.executable).parent))
    assert command is not None
    assert subprocess.run([command, "--help"], capture_output=True, text=True, check=True).stdout == module


# ------------------------------------------------------------------------------------ other packages' cues

CUE = '''
"""How bright the middle of the box is, with a plane of its own."""
from dataclasses import dataclass
import numpy as np
from pydantic import Field
from bayesnet_track.observation.cue import CueDeclaration, CueParameters, blend_arrays, floored


@dataclass(frozen=True)
class Brightness:
    inputs = ()
    margin = 0
    is_points = False

    def __str__(self):
        return "Brightness()"

    def compute(self, frames, inputs, region):
        return region.of(frames.current.image).mean(axis=2)


class GlowParameters(CueParameters):
    sd: float = Field(default=20.0, gt=0, description="spread, gray levels")


@dataclass(frozen=True)
class Glow:
    parameters: GlowParameters
    needs = (Brightness(),)

    def _at(self, planes, boxes):
        plane, region = planes[self.needs[0]], planes.region
        x = np.clip(np.rint(boxes[:, 0]).astype(int) - region.x0, 0, plane.shape[1] - 1)
        y = np.clip(np.rint(boxes[:, 1]).astype(int) - region.y0, 0, plane.shape[0] - 1)
        return plane[y, x]

    def learn(self, planes, box):
        return {"level": self._at(planes, box[None])}

    def blend(self, old, new, rate):
        return blend_arrays(old, new, rate)

    def log_likelihood(self, planes, hypotheses, reference):
        off = (self._at(planes, hypotheses.boxes) - reference["level"]) / self.parameters.sd
        return floored(-0.5 * off**2, self.parameters.floor)


GLOW = CueDeclaration("glow", "How bright the middle of the box is.", GlowParameters, Glow)
SAME = CueDeclaration("motion", "Another one.", GlowParameters, Glow)
WRONG = "no declaration"
'''

GRAPH = """\
bayesnet: 1
name: glowing
targets:
  spot:
    nodes:
      spot: {motion: {random_walk: {sd_px: {x: 8, y: 8}}}}
      glow: {parent: spot, agent: {glow: {sd: %s}}}
"""


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Installs a package `glow_cue` with these entry points, for this test."""

    def make(**points):
        site = tmp_path / "site"
        about = site / "glow_cue-1.0.dist-info"
        about.mkdir(parents=True)
        (site / "glow_cue.py").write_text(CUE)
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: glow-cue\nVersion: 1.0\n")
        lines = "".join(f"{name} = {value}\n" for name, value in points.items())
        (about / "entry_points.txt").write_text(f"[bayesnet_track.cues]\n{lines}")
        monkeypatch.syspath_prepend(str(site))
        plugins.forget()

    yield make
    monkeypatch.undo()
    sys.modules.pop("glow_cue", None)
    plugins.forget()


def test_built_in_cues_are_found():
    assert sorted(installed_cues()) == BUILT_IN


def test_a_cue_of_another_package_is_found_checked_and_run(install, tmp_path, capsys):
    install(glow="glow_cue:GLOW")
    allow = ["--allow-plugins", "glow"]
    good, bad = tmp_path / "good.yaml", tmp_path / "bad.yaml"
    good.write_text(GRAPH % "15")
    bad.write_text(GRAPH % "-1")
    assert main(["validate", str(good), *allow]) == 0
    assert main(["validate", str(bad), *allow]) == 3
    out, err = capsys.readouterr()
    assert "2 nodes, 1 of them agents" in out
    assert err.startswith(f"{bad}:7:47: glow: ") and "spread, gray levels" in err
    assert all(main([*line, *allow]) == 0 for line in (["list"], ["schema"], ["graph", str(good)]))
    out = capsys.readouterr().out
    assert "How bright the middle of the box is." in out and "plane    Brightness()" in out
    run = tmp_path / "run"
    line = ["demo", "--graph", str(good), "--end", "5", "--quiet", "--out", str(run), *allow]
    assert main(line) == 0
    assert [metrics.active for metrics in open_run(run).metrics] == [("glow",)] * 5


@pytest.mark.parametrize(
    ("point", "said"),
    [
        ("glow_cue:GONE", "module 'glow_cue' has no attribute 'GONE'"),
        ("not_there:CUE", "No module named 'not_there'"),
        ("glow_cue:WRONG", "glow_cue:WRONG is a str, not a CueDeclaration"),
        ("glow_cue:SAME", "it calls itself 'motion'"),
    ],
)
def test_a_broken_package_does_not_keep_other_graphs_from_running(install, tmp_path, point, said):
    install(glow=point)
    plugins.allow(["glow"])
    with pytest.warns(RuntimeWarning, match=re.escape(f"the cue 'glow' of glow-cue is left out: {said}")):
        cues = installed_cues(["glow"])
    assert sorted(cues) == BUILT_IN and cues["motion"].summary != "Another one."
    load_graph("general")
    path = tmp_path / "glow.yaml"
    path.write_text(GRAPH % "1")
    with pytest.raises(GraphError, match="'glow' of the package glow-cue, which cannot be loaded"):
        load_graph(path)


# ------------------------------------------------------------------------------------ the wheel


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("build")
    wanted = ("pyproject.toml", "setup.py", "README.md", "LICENSE", "bayesnet_track", "cues", "graphs")
    for name in wanted:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, folder)
    python("-m", "pip", "wheel", "--no-deps", "--wheel-dir", folder / "dist", folder, check=True)
    (built,) = (folder / "dist").glob("*.whl")
    return built


@pytest.mark.slow
def test_the_wheel_holds_everything_that_a_run_needs(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        (about,) = {name.split("/")[0] for name in names if ".dist-info/" in name}
        points = archive.read(f"{about}/entry_points.txt").decode()
    modules = {
        f"bayesnet_track/{path.relative_to(ROOT / 'bayesnet_track')}"
        for path in (ROOT / "bayesnet_track").rglob("*.py")
    }
    modules |= {f"bayesnet_track/cues/{path.name}" for path in (ROOT / "cues").glob("*.py")}
    graphs = {
        f"bayesnet_track/graphs/{path.name}" for path in (ROOT / "graphs").glob("*.*") if path.is_file()
    }
    page = {
        f"bayesnet_track/view/page/{path.name}" for path in (ROOT / "bayesnet_track/view/page").glob("*.?s*")
    }
    others = {"bayesnet_track/py.typed", f"{about}/licenses/LICENSE"}
    assert len(page) >= 2 and modules | graphs | page | others <= names
    assert {name for name in names if name.endswith((".py", ".yaml"))} <= modules | graphs
    assert {name.split("/")[0] for name in names} == {"bayesnet_track", about}
    assert "bayesnet-track = bayesnet_track.cli.main:main" in points
    assert all(f"{cue} = bayesnet_track.cues.{cue}:CUE" in points for cue in BUILT_IN)


@pytest.fixture(scope="module")
def site(wheel, tmp_path_factory):
    """The wheel installed in a folder, where its kernels are compiled once."""
    folder = tmp_path_factory.mktemp("installed") / "site"
    python("-m", "pip", "install", "--no-deps", "--target", folder, wheel, check=True)
    return folder


@pytest.mark.slow
def test_the_wheel_works_where_nothing_else_of_the_project_is(site, tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(site)}
    where = "import json, bayesnet_track, bayesnet_track.cues as c, bayesnet_track.graphs as g;"
    where += "print(json.dumps([m.__file__ for m in (bayesnet_track, c, g)]))"
    found = python("-c", where, cwd=tmp_path, env=environment, check=True)
    assert all(Path(name).is_relative_to(site) for name in json.loads(found.stdout))
    line = ("-m", "bayesnet_track", "demo", "--end", "3", "--out", tmp_path / "run")
    assert python(*line, cwd=tmp_path, env=environment).returncode == 0


DECOY = "import os\nwith open({log!r}, 'a') as log: log.write(f'{{__file__}} ran in {{os.getpid()}}\\n')\n"


@pytest.mark.slow
def test_an_installation_imports_nothing_from_the_working_directory(site, tmp_path):
    """Neither the program, nor a process that it starts: of agents, of a batch, of a decoder."""
    here, log = tmp_path / "here", tmp_path / "log"
    (here / "bayesnet_track").mkdir(parents=True)
    for name in ("cv2.py", "numpy.py", "numba.py", "av.py", "json.py", "bayesnet_track/__init__.py"):
        (here / name).write_text(DECOY.format(log=str(log)))
    environment = {**os.environ, "PYTHONPATH": str(site)}
    images = here / "images"
    images.mkdir()
    rng = np.random.default_rng(0)
    for index in range(3):
        cv2.imwrite(str(images / f"{index}.png"), rng.integers(0, 255, (60, 80, 3), dtype=np.uint8))

    def command(*line):
        # As the installed script: where the script is comes first in the path, not the working directory.
        return python("-P", "-m", "bayesnet_track", *line, cwd=here, env=environment)

    for line in (
        ("demo", "--end", "3", "--out", "a", "--quiet", "--executor", "processes", "--workers", "1"),
        (
            "run",
            "two_squares",
            "--source",
            "images",
            "--init",
            "9,9,20,20",
            "--out",
            "b",
        ),
        ("batch", "two_squares", "--source", "images", "--init", "9,9,20,20", "--out", "c", "--jobs", "1"),
    ):
        done = command(*line)
        assert (done.returncode, log.exists()) == (0, False), done.stderr
    journal = (here / "a" / "journal.jsonl").read_text()
    assert "missed" not in journal and "quarantined" not in journal
    assert (here / "a" / "tracks.txt").read_text() and not (here / "a" / "inputs.jsonl").exists()
