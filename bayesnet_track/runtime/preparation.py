"""What a run has in common with one that goes on, before the first frame: engine, files, checkpoints."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from typing import Any

from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.engine.step import Engine, make_engine
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.journal.writer import LineFile, write_atomically, writing
from bayesnet_track.observation.detector import GIVEN
from bayesnet_track.runtime.checkpoints.checkpoint import Checkpoints
from bayesnet_track.runtime.checkpoints.recipe import Recipe
from bayesnet_track.runtime.executors import RETRIES, Executing
from bayesnet_track.runtime.recording.record import Recorder
from bayesnet_track.runtime.recording.rundir import FILES, RunDirectory
from bayesnet_track.runtime.resizing import Resizing
from bayesnet_track.runtime.results import FrameSource
from bayesnet_track.sources.detection_files import FileDetector
from bayesnet_track.sources.frames import Source
from bayesnet_track.sources.scan_files import ScanFile


def place_cues(
    stack: ExitStack,
    executing: Executing,
    engine: Engine,
    source: FrameSource,
    budget_ms: float | None,
) -> Engine:
    """The engine with its agents where they work, until `stack` closes.

    Where frames do not wait, as those of a camera or with a budget, no agent is asked again.

    Raises:
        PlacingError: an agent cannot be where it was put.
    """
    waits = budget_ms is None and not getattr(source, "is_live", False)
    return stack.enter_context(executing).engine(engine, RETRIES if waits else 0)


def prepare_engine(
    graph: CheckedGraph,
    seed: int,
    motion: MotionModel | None,
    detector: FileDetector | ScanFile | None,
) -> Engine:
    """The engine of a run, with the detector of a file where there is one; raises as `track`."""
    own = None if motion is None else dict.fromkeys(graph.targets, motion)
    given: dict[str, Any] = {} if detector is None else {GIVEN: detector}
    return make_engine(graph, seed, motion=own, detectors=given)


def resizing_of(source: FrameSource, max_side: int | None) -> Resizing:
    """The resizing of the frames of a source, which is told of it; raises ValueError if they have depth."""
    resizing = Resizing.to(source.width, source.height, max_side)
    if not resizing.is_none and getattr(source, "has_depth", False):
        raise ValueError("max_side: frames with depth cannot be resized; allowed: frames of one camera")
    if isinstance(source, Source) and not resizing.is_none:
        source.tracked = resizing.tracked
    return resizing


def small_files(graph: CheckedGraph, recipe: Recipe, truth: str | None = None) -> dict[str, bytes]:
    """The request as files by their key in `FILES`; `truth` is the truth.txt of a built-in scene."""
    texts = {"graph": graph.text, "truth": truth, "recipe": recipe.text()}
    return {key: text.encode("utf-8") for key, text in texts.items() if text is not None}


def held_files(directory: RunDirectory, truth: str | None) -> dict[str, bytes]:
    """The same of a run that goes on, as they are now, but for the scene's `truth`.

    Raises:
        OutputError: one cannot be read or written.
    """
    found = {} if truth is None else {"truth": truth.encode("utf-8")}
    for key, data in found.items():  # earlier versions wrote it in the end
        write_atomically(directory.path / FILES[key], data)
    for key in ("graph", "truth", "recipe"):
        path = directory.path / FILES[key]
        with writing(path):
            if path.exists():
                found[key] = path.read_bytes()
    return found


def begin(directory: RunDirectory, files: Mapping[str, bytes]) -> None:
    """Write down what is asked for, before anything is done; the recipe comes last: with it all is there.

    Raises:
        OutputError: it cannot be written.
    """
    # What holds a journal counts as a run, which may be overwritten.
    LineFile(directory.journal).close()
    for key, data in files.items():
        write_atomically(directory.path / FILES[key], data)


def make_checkpointer(
    directory: RunDirectory, engine: Engine, recorder: Recorder, recipe: Recipe, every_s: float
) -> Checkpoints | None:
    """The checkpointer of a run; None if no checkpoints are made, or nothing could go on from them."""
    if every_s <= 0 or recipe.origin.only_once is not None or opaque_agents(engine):
        return None
    return Checkpoints(directory, recorder, recipe.sha256, every_s)


def opaque_agents(engine: Engine) -> tuple[str, ...]:
    """Agents that keep something which cannot be stored."""
    return tuple(agent for compiled in engine.plates.values() for agent in sorted(compiled.opaque))
