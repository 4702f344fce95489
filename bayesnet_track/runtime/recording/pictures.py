"""The pictures that a run was tracked in, read again: from its source, or from the video that it wrote."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.journal.events.runs import RunStarted
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.recording.rundir import RunDirectory
from bayesnet_track.sources.paths import SourceError

if TYPE_CHECKING:
    from bayesnet_track.runtime.results import FrameSource

SCENE = "scene:"


@dataclass(frozen=True, eq=False)
class Found:
    """Pictures of a run.

    Attributes:
        images: frame, and (H, W, 3) uint8 BGR, in order; of a damaged source as far as it can be read.
        annotated: whether what was believed is drawn into them.
    """

    images: Iterator[tuple[int, NDArray[np.uint8]]]
    annotated: bool = False


@contextmanager
def pictures_of(
    directory: RunDirectory, started: RunStarted, first: int, last: int
) -> Iterator[tuple[Found | None, str]]:
    """The pictures of frames `first` to `last`, with why they are not those of the source, or not there.

    The source is opened as it was for the run, but never over the network; where it is gone, or its pictures
    have another size now, the run's own annotated video takes its place.
    """
    reasons = []
    for open_one in (_source, _video):
        try:
            source = open_one(directory, started)
        except (SourceError, OSError, ValueError) as error:
            reasons.append(str(error))
            continue
        try:
            annotated = open_one is _video
            size = started.width, started.height
            sizes = (size, _video_size(directory, size)) if annotated else (size,)
            if (source.width, source.height) in sizes:
                # The video has the frames that were tracked, one after the other.
                place = (first, _stride(directory)) if annotated else (0, 1)
                images = _between(source, first, last, place)
                yield Found(_of_size(images, size), annotated), ""
                return
            was = f"{started.width}x{started.height}"
            reasons.append(f"{source.description} is {source.width}x{source.height} px now, and was {was}")
        finally:
            close = getattr(source, "close", None)
            if close is not None:
                close()
    yield None, "; ".join(reasons)


def _between(
    source: FrameSource, first: int, last: int, place: tuple[int, int]
) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """The images of frames `first` to `last`; `place`: number of the source's first one, and the step."""
    for item in source:
        index = place[0] + place[1] * item.index if isinstance(item, Frame) else -1
        if not isinstance(item, Frame) or index < first:
            continue
        if index > last:
            return
        yield index, item.image


def _of_size(
    images: Iterator[tuple[int, NDArray[np.uint8]]], size: tuple[int, int]
) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """The same images in the size of the source, in which boxes are given."""
    import cv2

    for index, image in images:
        has_size = image.shape[1::-1] == size
        yield index, image if has_size else np.asarray(cv2.resize(image, size), dtype=np.uint8)


def _video_size(directory: RunDirectory, size: tuple[int, int]) -> tuple[int, int]:
    """The size of the annotated video of a run whose source has frames of `size`."""
    from bayesnet_track.runtime.checkpoints.recipe import Recipe
    from bayesnet_track.runtime.recording.videowriter import LONGEST_SIDE, video_size

    side = Recipe.read(directory).video_side if directory.recipe.is_file() else None
    return video_size(*size, side or LONGEST_SIDE)


def _stride(directory: RunDirectory) -> int:
    from bayesnet_track.runtime.checkpoints.recipe import Recipe

    return Recipe.read(directory).origin.stride if directory.recipe.is_file() else 1


def _source(directory: RunDirectory, started: RunStarted) -> FrameSource:
    """The run's source: as its recipe says, or, of a run without one, as its journal names it."""
    from bayesnet_track.runtime.checkpoints.recipe import Recipe
    from bayesnet_track.sources.reopen import reopen
    from bayesnet_track.sources.scenes import make_scene
    from bayesnet_track.sources.scenes.library import SceneSource
    from bayesnet_track.sources.sources import open_source

    if directory.recipe.is_file():
        origin = Recipe.read(directory).origin
        if origin.only_once is not None:
            raise SourceError(started.source, origin.only_once, "a source of files", "keep the video")
        return reopen(replace(origin, allow_network=False))
    if started.source.startswith(SCENE):
        return SceneSource(make_scene(started.source[len(SCENE) :], seed=started.seed), started.source)
    if started.source.isascii() and started.source.isdigit():
        raise SourceError(started.source, "it was a camera", "a source of files", "keep the video")
    return open_source(started.source)


def _video(directory: RunDirectory, started: RunStarted) -> FrameSource:
    from bayesnet_track.sources.sources import open_source

    video = directory.mp4 if directory.mp4.is_file() else directory.video
    if not video.is_file():
        raise FileNotFoundError(f"and the run wrote no {video.name}")
    return open_source(str(video))
