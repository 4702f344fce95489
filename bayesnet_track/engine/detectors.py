"""Detectors that give targets their births: one of each kind, and of several cameras one of each camera."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.graph.checks.cues import plugin_parameters
from bayesnet_track.graph.settings.lifecycle import LifeRules
from bayesnet_track.graph.text.write import as_plain, flow_text
from bayesnet_track.inference.views import Views
from bayesnet_track.observation.detector import (
    GIVEN,
    Detector,
    DetectorError,
    detectors_of_graphs,
    of_camera,
)
from bayesnet_track.observation.settings import setting, to_caller
from bayesnet_track.vision.detectors.selection import Selected


def make_detectors(
    asking: Iterable[tuple[CheckedTarget, Mapping[str, str]]], given: Mapping[str, Detector]
) -> dict[str, Detector]:
    """The detectors of births, by the names that plates ask for: each plate's, of every camera that sees it.

    Raises:
        DetectorError: one cannot be made, or those that are given are not those that are asked for.
    """
    made: dict[str, Detector] = {}
    asked = set()
    for plate, detectors in asking:
        assert plate.spec.birth is not None
        chosen = plate.spec.birth.detector
        for camera, name in detectors.items():
            wanted = of_camera(chosen.detector, camera)
            asked.add(wanted)
            if name in made:
                continue
            if plate.inverses:
                made[name] = _scanner_of(plate, given)
                continue
            declaration = detectors_of_graphs([chosen.detector])[chosen.detector]
            parameters = plugin_parameters(chosen, declaration.parameters)
            if wanted in given:
                made[name] = Selected(given[wanted], parameters)
            elif camera and chosen.detector == GIVEN:
                named = "detections={" + f'"{camera}": FILE' + "}"
                ways = to_caller(f"--detections {camera}=FILE", named)
                raise DetectorError(
                    f"{plate.name} is seen by {' and '.join(detectors)}, and no detections of {camera} are "
                    f"given; give those of each camera ({ways})"
                )
            else:
                made[name] = declaration.make(parameters)
    idle = [name for name in given if name not in asked]
    if idle:
        raise DetectorError(f"{idle[0]} are given, and no plate of the graph has births by them")
    return made


def detectors_of(life: LifeRules | None, views: Views | None) -> dict[str, str]:
    """Camera -> name of the detector of a plate's births in its images; "" without `views`."""
    if life is None or life.birth is None:
        return {}
    name = flow_text(as_plain(life.birth.detector))
    cameras = ("",) if views is None else [one.seen_by for one in views.views.values()]
    return {camera: of_camera(name, camera) for camera in cameras}


def _scanner_of(plate: CheckedTarget, given: Mapping[str, Any]) -> Any:
    """What gives the sensors of a plate their detections."""
    scanner = given.get(GIVEN)
    if scanner is None or not hasattr(scanner, "scans"):
        what = "none are given" if scanner is None else "boxes are given"
        raise DetectorError(
            f"the sensors of {plate.name} ({', '.join(plate.inverses)}) measure detections "
            f"of quantities, and {what}; give a CSV file of them ({setting('--detections')}), or use "
            "DetectionsTracker"
        )
    return scanner
