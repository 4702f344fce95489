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
    asking: Iterable[tuple[CheckedTarget, Mapping[str, str]]], supplied: Mapping[str, Detector]
) -> dict[str, Detector]:
    """The detectors of births, by the names that plates ask for: each plate's, of every camera that sees it.

    Raises:
        DetectorError: one cannot be made, or those that are given are not those that are asked for.
    """
    by_name: dict[str, Detector] = {}
    requested = set()
    for plate, detectors in asking:
        assert plate.spec.birth is not None
        plugin = plate.spec.birth.detector
        for camera, name in detectors.items():
            requested_name = of_camera(plugin.detector, camera)
            requested.add(requested_name)
            if name in by_name:
                continue
            if plate.inverses:
                by_name[name] = _scanner_of(plate, supplied)
                continue
            declaration = detectors_of_graphs([plugin.detector])[plugin.detector]
            parameters = plugin_parameters(plugin, declaration.parameters)
            if requested_name in supplied:
                by_name[name] = Selected(supplied[requested_name], parameters)
            elif camera and plugin.detector == GIVEN:
                named = "detections={" + f'"{camera}": FILE' + "}"
                ways = to_caller(f"--detections {camera}=FILE", named)
                raise DetectorError(
                    f"{plate.name} is seen by {' and '.join(detectors)}, and no detections of {camera} are "
                    f"given; give those of each camera ({ways})"
                )
            else:
                by_name[name] = declaration.make(parameters)
    idle = [name for name in supplied if name not in requested]
    if idle:
        raise DetectorError(f"{idle[0]} are given, and no plate of the graph has births by them")
    return by_name


def detectors_of(life: LifeRules | None, views: Views | None) -> dict[str, str]:
    """Camera -> name of the detector of a plate's births in its images; "" without `views`."""
    if life is None or life.birth is None:
        return {}
    name = flow_text(as_plain(life.birth.detector))
    cameras = ("",) if views is None else [view.seen_by for view in views.views.values()]
    return {camera: of_camera(name, camera) for camera in cameras}


def _scanner_of(plate: CheckedTarget, supplied: Mapping[str, Any]) -> Any:
    """The scanner that gives the sensors of a plate their detections."""
    scanner = supplied.get(GIVEN)
    if scanner is None or not hasattr(scanner, "scans"):
        fault = "none are given" if scanner is None else "boxes are given"
        raise DetectorError(
            f"the sensors of {plate.name} ({', '.join(plate.inverses)}) measure detections "
            f"of quantities, and {fault}; give a CSV file of them ({setting('--detections')}), or use "
            "DetectionsTracker"
        )
    return scanner
