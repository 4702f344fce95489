"""A tracking function for CVAT's agents: the tracker inside CVAT, which gives up where it is unsure.

CVAT's command line finds `create` here, and gives it the parameters that stand behind `-p`.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from bayesnet_track.engine.starts import StartError
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.runtime.tracker import Tracker
from bayesnet_track.sources.entrances.notices import notice

THRESHOLD = 0.5
RECTANGLE = "rectangle"


def create(graph: str = "general", threshold: float = THRESHOLD, seed: int = 0) -> CvatTracking:
    """The function with a graph, which gives no shape where its probability is below `threshold`."""
    return CvatTracking(graph, threshold, seed)


class CvatTracking:
    """Meets `cvat_sdk.auto_annotation.TrackingFunction`; a state is a tracker, which learns as it goes on."""

    def __init__(self, graph: str, threshold: float, seed: int) -> None:
        self._graph, self._threshold, self._seed = load_graph(graph), threshold, seed

    @property
    def spec(self) -> Any:
        """It tracks rectangles."""
        return _sdk().TrackingFunctionSpec(supported_shape_types=[RECTANGLE])

    def preprocess_image(self, context: object, image: Any) -> Any:
        """The PIL image as an array (H, W, 3) uint8, BGR."""
        return np.ascontiguousarray(np.asarray(image.convert("RGB"))[:, :, ::-1])

    def init_tracking_state(self, context: object, pp_image: Any, shape: Any) -> Tracker | None:
        """A tracker that has started on the rectangle; None, with a notice, where none can.

        CVAT asks for all rectangles of a frame together: the others are tracked.
        """
        left, top, right, bottom = (float(value) for value in shape.points)
        tracker = Tracker(self._graph, self._seed)
        try:
            tracker.init(pp_image, (left, top, right - left, bottom - top))
        except StartError as error:
            notice(f"a rectangle is not tracked: {error}")
            return None
        return tracker

    def track(self, context: object, pp_image: Any, state: Tracker | None) -> Any:
        """The rectangle in the next image; None where the probability of being on target is too low."""
        if state is None:
            return None
        state.update(pp_image)
        if state.score < self._threshold:
            return None
        return _sdk().TrackableShape(type=RECTANGLE, points=[float(value) for value in state.xyxy])


def _sdk() -> Any:
    return import_module("cvat_sdk.auto_annotation")
