"""Open a source again from what is recorded of it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from bayesnet_track.sources.frames import Source
from bayesnet_track.sources.origin import Origin
from bayesnet_track.sources.paths import SourceError
from bayesnet_track.sources.scenes.library import SceneSource
from bayesnet_track.sources.several import SeveralSources
from bayesnet_track.sources.sources import open_source
from bayesnet_track.sources.stereo_source import open_stereo_source

OpenCamera = Callable[[str, Origin], Any]
"""Opens the source of one of several cameras, by its name and how it was opened before."""


def reopen(origin: Origin, open_camera: OpenCamera | None = None) -> Source | SceneSource | SeveralSources:
    """The source from its first frame on; its paths where they were, or else as given.

    Each of several cameras is opened by `open_camera`, if it is given.

    Raises:
        SourceError: it can only be read once, or no longer.
        CalibrationError: the calibration file cannot be used.
    """
    if origin.only_once is not None:
        raise SourceError(
            origin.description, origin.only_once, "files and built-in scenes", "start a new run"
        )
    if origin.kind == "scene":
        return SceneSource.named(origin.text, origin.seed, origin.end)
    if origin.cameras:
        return SeveralSources.opened(
            {
                camera: partial(reopen, part) if open_camera is None else partial(open_camera, camera, part)
                for camera, part in origin.cameras.items()
            },
            origin.start,
            origin.end,
        )
    places = origin.places()
    # What is read again are files, however they are named: a run directory is data and allows nothing.
    window = (origin.start, origin.end, False, origin.on_resize)
    if origin.kind == "plain":
        source = open_source(
            places[origin.text],
            *window,
            origin.stride,
            value_range=origin.value_range,
            size=origin.size,
        )
    else:
        source = open_stereo_source(
            places[origin.text],
            *window,
            right=None if origin.right is None else places[origin.right],
            depth=None if origin.depth is None else places[origin.depth],
            side_by_side=origin.kind == "side_by_side",
            calibration=None if origin.calibration is None else places[origin.calibration],
            stride=origin.stride,
            value_range=origin.value_range,
        )
    source.description, source.origin = origin.description, origin
    return source
