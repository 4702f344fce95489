"""`doctor`: what it says of broken installations, each made by hand, and that nothing broken stops it."""

import json
import os
import re
import subprocess
import sys
import tomllib
import urllib.request  # noqa: F401 - loaded before the folder of packages is hidden
from argparse import Namespace
from pathlib import Path

import packaging.requirements  # noqa: F401 - likewise
import pytest

import bayesnet_track
from bayesnet_track.cli import doctor
from bayesnet_track.cli.doctor import CheckResult, try_code

ROOT = Path(__file__).parents[2]


def distribution(folder, name, version, requires=(), **files):
    about = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    about.mkdir(parents=True)
    needs = "".join(f"Requires-Dist: {one}\n" for one in requires)
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n{needs}")
    for file, text in files.items():
        (about / file.replace("__", ".")).write_text(text)


@pytest.fixture
def site(tmp_path, monkeypatch):
    """A folder of installed packages, the only one that is seen."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.setattr(sys, "path", [str(folder)])
    return folder


def only(findings):
    (found,) = findings
    return found


# ------------------------------------------------------------------------------------ what is installed


@pytest.mark.parametrize(
    ("second", "kept"),
    [
        ("opencv-python", "opencv-python-headless"),
        ("opencv-contrib-python", "opencv-contrib-python-headless"),
        ("opencv-contrib-python-headless", "opencv-contrib-python-headless"),
    ],
)
def test_two_wheels_of_opencv(site, second, kept):
    distribution(site, "opencv-python-headless", "5.0.0")
    distribution(site, second, "4.10.0")
    found = next(one for one in doctor.check_versions() if one.check == "opencv wheels")
    assert found.level == "broken" and f"{second} 4.10.0" in found.text
    assert re.search(rf"uninstall -y (?=.*{second}\b).* && .*install \"{kept}>=4.9,<6\"$", found.cure)


def test_versions_out_of_range_and_packages_that_are_missing(site):
    distribution(site, "bayesnet-track", "1", ["alpha>=2,<3", "beta", 'gamma; extra == "more"', "delta>=1"])
    distribution(site, "alpha", "3.1", ["delta<1", 'delta<0.1; extra == "odd"'])
    distribution(site, "delta", "1.4")
    found = {one.text: one.cure for one in doctor.check_versions()}
    assert found == {
        "alpha 3.1 is not <3,>=2": 'python -m pip install "alpha<3,>=2"',
        "alpha 3.1 needs delta<1, not 1.4": 'python -m pip install "delta<1"',
        "beta is missing": 'python -m pip install "beta"',
    }


def test_any_wheel_of_opencv_will_do(site):
    distribution(site, "bayesnet-track", "1", ["opencv-python-headless>=4.9"])
    distribution(site, "opencv-contrib-python", "4.10.0")
    assert only(doctor.check_versions()).level == "ok"


def test_a_checkout_that_is_not_installed(site):
    found = only(doctor.check_package())
    assert found.level == "broken" and "is not installed" in found.text and "pip install -e" in found.cure
    found = only(doctor.check_plugins())
    assert found.level == "broken" and "no cues" in found.text


def test_a_checkout_that_shadows_what_is_installed(site):
    distribution(site, "bayesnet-track", "0.0.1")
    (site / "bayesnet_track").mkdir()
    (site / "bayesnet_track" / "__init__.py").touch()
    found = only(doctor.check_package())
    assert found.level == "broken" and f"shadows the installed 0.0.1 in {site}" in found.text


def test_an_editable_installation_is_where_it_says(site):
    home = Path(bayesnet_track.__file__).parents[1]
    origin = json.dumps({"url": home.as_uri(), "dir_info": {"editable": True}})
    distribution(site, "bayesnet-track", "0.0.1", direct_url__json=origin)
    assert only(doctor.check_package()).level == "ok"


def test_every_extra_that_is_offered_is_one():
    offered = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    for name, (_, extra) in doctor.EXTRAS.items():
        assert any(re.match(rf"{name}\b", needed) for needed in offered[extra])


# ------------------------------------------------------------------------------------ libraries


def patched(monkeypatch, tmp_path, code, name="sitecustomize"):
    """A module that is found first by the processes in which a check tries things out."""
    (tmp_path / "first").mkdir()
    (tmp_path / "first" / f"{name}.py").write_text(code)
    monkeypatch.setattr(sys, "path", [str(tmp_path / "first"), *sys.path])


@pytest.mark.parametrize(
    ("name", "code", "text", "cure"),
    [
        (
            "cv2",
            "raise ImportError('libGL.so.1: cannot open shared object file')",
            "libGL.so",
            "uninstall -y",
        ),
        ("cv2", "raise ImportError('multiarray failed to import')", "multiarray", "--force-reinstall"),
        ("numba", "raise ImportError('Numba needs NumPy 2.3 or less.')", "needs NumPy 2.3", "numba numpy"),
        ("av", "import os; os.abort()", "died of signal 6", "--force-reinstall av"),
        ("numpy", "raise ImportError('no')", "no", "--force-reinstall numpy"),
    ],
)
def test_a_broken_library(monkeypatch, tmp_path, name, code, text, cure):
    patched(monkeypatch, tmp_path, code, name)
    monkeypatch.setattr(doctor, "LIBRARIES", {name: doctor.LIBRARIES[name]})
    found = only(doctor.check_libraries())
    assert found.level == "broken" and text in found.text and cure in found.cure


NEW_AV = """
import av
old = av.open
def newer(file, mode="r", **settings):
    if mode == "r":
        raise TypeError("open() got an unexpected keyword argument")
    return old(file, mode, **settings)
av.open = newer
"""
NO_FORK = """
import os
def fork(): raise PermissionError(1, "no process for you")
os.fork = fork
"""


@pytest.mark.slow
@pytest.mark.parametrize("code", [NEW_AV, NO_FORK], ids=["video", "worker"])
def test_a_library_that_is_there_and_that_the_program_cannot_use(monkeypatch, tmp_path, code):
    """As PyAV 19 was: it could be imported, knew all codecs, and opened no video for this program."""
    patched(monkeypatch, tmp_path, code)
    found = only(doctor.check_tracking())
    assert found.level == "broken" and found.text and found.cure == doctor.REPORT


@pytest.mark.slow
def test_ten_frames_work_here():
    found = only(doctor.check_tracking())
    assert found.level == "ok" and "the same in a worker process" in found.text


def test_a_process_that_hangs_is_given_up():
    assert try_code("import time; time.sleep(60)", timeout_s=0.2) == ("", "no answer within 0 s")


def test_plug_ins_that_cannot_be_loaded_and_those_that_are_not_even_there(site):
    """What other packages declare is not loaded: that would run their code."""
    points = (
        "[bayesnet_track.cues]\na = json:NOTHING\nb = json:NOTHING\n[bayesnet_track.detectors]\nc = json:d\n"
    )
    distribution(site, "bayesnet-track", "1", entry_points__txt=points)
    other = "[bayesnet_track.cues]\ngone = no_such_module:CUE\nthere = present:CUE\n"
    distribution(site, "glow-cue", "1", entry_points__txt=other)
    (site / "present.py").write_text("raise SystemExit('it ran')")
    first, second = doctor.check_plugins()
    assert (first.level, second.level) == ("broken", "broken")
    assert "AttributeError" in first.text
    assert "glow-cue declares 'gone', and no_such_module is not there" in second.text


# ------------------------------------------------------------------------------------ the command


def test_a_check_that_fails_is_a_finding(monkeypatch):
    def check_the_moon():
        yield CheckResult("moon", "ok", "up")
        raise OSError("gone")

    monkeypatch.setattr(doctor, "CHECKS", (check_the_moon,))
    assert [one.level for one in doctor.examine()] == ["ok", "broken"]


@pytest.mark.parametrize(("level", "code"), [("ok", 0), ("note", 0), ("broken", 1)])
def test_the_exit_code(monkeypatch, capsys, level, code):
    monkeypatch.setattr(doctor, "examine", lambda: iter([CheckResult("moon", level, "here", "look up")]))
    assert doctor.doctor(Namespace(json=False)) == code
    assert "moon          here\n                     → look up\n" in capsys.readouterr().out
    assert doctor.doctor(Namespace(json=True)) == code
    assert json.loads(capsys.readouterr().out)[0]["cure"] == "look up"


@pytest.mark.slow
def test_this_installation_is_well():
    line = [sys.executable, "-m", "bayesnet_track", "doctor", "--json"]
    done = subprocess.run(line, capture_output=True, text=True)
    levels = {one["check"]: one["level"] for one in json.loads(done.stdout)}
    assert levels["ten frames"] == levels["plug-ins"] == levels["versions"] == "ok"


@pytest.mark.slow
def test_it_works_without_any_library(tmp_path):
    """A fresh environment and a checkout: the standard library is all that is there."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(tmp_path / "new")], check=True)
    folder = tmp_path / "new" / ("Scripts" if os.name == "nt" else "bin")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    line = [str(folder / "python"), "-m", "bayesnet_track", "doctor", "--json"]
    done = subprocess.run(line, capture_output=True, text=True, cwd=tmp_path, env=environment)
    assert done.returncode == 1 and "Traceback" not in done.stderr
    found = json.loads(done.stdout)
    broken = {one["check"] for one in found if one["level"] == "broken"}
    assert {"package", "versions", "numpy", "cv2", "numba", "av", "plug-ins", "ten frames"} <= broken
    assert all(one["cure"] for one in found if one["level"] == "broken")
