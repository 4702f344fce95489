"""Detectors of other packages."""

from __future__ import annotations

import sys

import pytest

from bayesnet_track.cli import main
from bayesnet_track.detector import installed_detectors

PACKAGE = """
import numpy as np
from bayesnet_track.detector import Detections, DetectorDeclaration, DetectorParameters

class Middle:
    def start(self):
        return {"seen": np.zeros(1)}

    def detect(self, frames, state):
        box = np.array([[frames.current.width / 2, frames.current.height / 2, 20.0, 10.0]])
        return Detections(box, np.ones(1), ("middle",)), {"seen": state["seen"] + 1}

MIDDLE = DetectorDeclaration("middle", "The middle.", DetectorParameters, lambda parameters: Middle())
SAME = DetectorDeclaration("motion", "Another one.", DetectorParameters, lambda parameters: Middle())
"""


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Installs a package `middle_detector` with this entry point, for this test."""

    def make(point):
        about = tmp_path / "middle_detector-1.0.dist-info"
        about.mkdir()
        (tmp_path / "middle_detector.py").write_text(PACKAGE)
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: middle-detector\nVersion: 1.0\n")
        (about / "entry_points.txt").write_text(f"[bayesnet_track.detectors]\nmiddle = {point}\n")
        monkeypatch.syspath_prepend(str(tmp_path))
        installed_detectors.cache_clear()

    yield make
    monkeypatch.undo()
    sys.modules.pop("middle_detector", None)
    installed_detectors.cache_clear()


def test_a_detector_of_another_package_is_found_and_run(install, tmp_path, capsys):
    import cv2
    import numpy as np

    install("middle_detector:MIDDLE")
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((40, 60, 3), np.uint8))
    assert main(["detect", "middle", "--source", str(tmp_path)]) == 0
    assert capsys.readouterr().out == "1,-1,20.500,15.500,20.000,10.000,1.000000,-1,-1,-1\n"


@pytest.mark.parametrize(
    ("point", "said"),
    [
        ("middle_detector:GONE", "has no attribute 'GONE'"),
        ("middle_detector:Middle", "is a type, not a DetectorDeclaration"),
        ("middle_detector:SAME", "another detector has the name 'motion'"),
    ],
)
def test_a_broken_one_is_left_out_with_a_warning(install, point, said):
    install(point)
    with pytest.warns(RuntimeWarning, match="the detector 'middle' of middle-detector is left out") as warned:
        found = installed_detectors()
    assert said in str(warned[0].message)
    assert "middle" not in found and found["motion"].summary != "Another one."
