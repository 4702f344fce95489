"""Scans: what one sensor saw at one time."""

import numpy as np

from bayesnet_track.observation.detector import Scan, Scanner


def test_a_scan_is_as_long_as_its_detections():
    assert len(Scan(np.zeros((3, 2)), np.ones(3))) == 3


def test_whatever_has_scans_is_a_scanner():
    class Own:
        def scans(self, frame):
            return {}

    assert isinstance(Own(), Scanner)
    assert not isinstance(object(), Scanner)
