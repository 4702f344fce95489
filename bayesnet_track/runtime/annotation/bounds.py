"""Boxes that no tracker starts from: the rule of the tracker itself, asked before anything is tracked."""

from __future__ import annotations

from bayesnet_track.engine.starts import Start, StartError, check_box
from bayesnet_track.runtime.annotation.answers import Box
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.runtime.resizing import Resizing


def describe_untrackable(box: Box, video: Video, max_side: int | None = None) -> str | None:
    """Why a tracker refuses to start from the box in a frame of the video; None where it does not.

    >>> describe_untrackable((10, 10, 0.5, 20), Video("a.mp4", 9, 320, 240, 0.04))
    'start box 10,10,0.5,20: width and height must be at least 1 px'
    """
    try:
        check_box(box, video.width, video.height)
        Resizing.to(video.width, video.height, max_side).start(Start(box))
    except StartError as error:
        return str(error)
    return None
