"""bayesnet_track: a small probabilistic language for visual tracking.

Write a Bayes net in YAML, run it on a video, read why it reconfigured itself::

    from bayesnet_track import Tracker

    tracker = Tracker("general")
    tracker.init(frame, (x, y, w, h))
    ok, box = tracker.update(next_frame)

What is imported here loads when it is first used, so that `import bayesnet_track` stays cheap.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bayesnet_track.graph.spec import GraphSpec as GraphSpec
    from bayesnet_track.graph.text.load import load_graph as load_graph
    from bayesnet_track.observation.cue import CueDeclaration as CueDeclaration
    from bayesnet_track.observation.cue import CueParameters as CueParameters
    from bayesnet_track.observation.geometry import box_means as box_means
    from bayesnet_track.observation.likelihoods import floored as floored
    from bayesnet_track.runtime.detections_tracker import DetectionsTracker as DetectionsTracker
    from bayesnet_track.runtime.recording.interchange import Detections as Detections
    from bayesnet_track.runtime.recording.run_reader import Run as Run
    from bayesnet_track.runtime.recording.run_reader import open_run as open_run
    from bayesnet_track.runtime.results import Result as Result
    from bayesnet_track.runtime.run import Start as Start
    from bayesnet_track.runtime.session import track as track
    from bayesnet_track.runtime.tracker import Tracker as Tracker
    from bayesnet_track.vision.planes import GrayPlane as GrayPlane

    __version__: str

_HOMES = {
    "CueDeclaration": "bayesnet_track.observation.cue",
    "CueParameters": "bayesnet_track.observation.cue",
    "Detections": "bayesnet_track.runtime.recording.interchange",
    "DetectionsTracker": "bayesnet_track.runtime.detections_tracker",
    "GraphSpec": "bayesnet_track.graph.spec",
    "GrayPlane": "bayesnet_track.vision.planes",
    "Result": "bayesnet_track.runtime.run",
    "Run": "bayesnet_track.runtime.recording.run_reader",
    "Start": "bayesnet_track.runtime.run",
    "Tracker": "bayesnet_track.runtime.tracker",
    "box_means": "bayesnet_track.observation.geometry",
    "floored": "bayesnet_track.observation.likelihoods",
    "load_graph": "bayesnet_track.graph.text.load",
    "open_run": "bayesnet_track.runtime.recording.run_reader",
    "track": "bayesnet_track.runtime.session",
}

__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    if name == "__version__":
        return import_module("importlib.metadata").version("bayesnet-track")
    raise AttributeError(f"module 'bayesnet_track' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
