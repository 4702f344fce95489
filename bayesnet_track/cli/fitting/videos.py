"""The videos of `fit`: which there are, their ground truth, and their frames."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bayesnet_track.cli.arguments import UsageError, users_mistake

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from bayesnet_track.observation.planes import Frame


@dataclass(frozen=True, eq=False)
class Video:
    """A source and its true corner boxes (n, 4)."""

    name: str
    source: str
    truth: NDArray[np.float64]
    value_range: tuple[float, float] | None = None


def find_videos(options: argparse.Namespace) -> Iterator[Video]:
    """Those of `--source` with `--truth`, and of `--folder`."""
    from bayesnet_track.evaluate.truth import read_truth

    if len(options.source) != len(options.truth):
        raise UsageError(
            f"{len(options.source)} --source and {len(options.truth)} --truth: every video needs its truth"
        )
    pairs = [(_name(s), s, Path(t)) for s, t in zip(options.source, options.truth, strict=True)]
    if options.folder is not None:
        found = sorted(Path(options.folder).glob("*/groundtruth.txt"))
        pairs += [(f.parent.name, str(f.parent / "img"), f) for f in found if (f.parent / "img").is_dir()]
        if not found:
            raise UsageError(f"{options.folder}: no NAME/groundtruth.txt beside NAME/img")
    if not pairs:
        raise UsageError("no video: give --source with --truth, or --folder")
    seen: dict[str, int] = {}
    for name, source, file in pairs:
        seen[name] = seen.get(name, 0) + 1
        with users_mistake():
            unique = name if seen[name] == 1 else f"{name} {seen[name]}"
            yield Video(unique, source, read_truth(file, options.truth_format), options.value_range)


@contextmanager
def frames_of(video: Video, end: int | None) -> Iterator[Iterator[Frame]]:
    """The frames of a video before `end`, all that there are when it is None."""
    from bayesnet_track.observation.planes import Frame
    from bayesnet_track.sources.sources import open_source

    with open_source(video.source, 0, end, value_range=video.value_range) as source:
        expected = source.expected_frames
        if expected is not None and end is None and expected != len(video.truth):
            raise UsageError(f"{video.name}: {expected} frames, and {len(video.truth)} boxes of ground truth")
        yield (item for item in source if isinstance(item, Frame))


def _name(source: str) -> str:
    """What a source is called: a folder of pictures of a sequence is called as the sequence is."""
    path = Path(source)
    return (path.parent if path.name in ("img", "img1") else path).name or source
