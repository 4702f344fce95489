"""The recipe of a run: everything that was asked for and that changes its results, in ``run.json``.

With graph.yaml beside it, it is enough to do the same again: to go on where a run stopped, to ask what would
have been, to see the frames.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cache
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from bayesnet_track.engine.starts import Start
from bayesnet_track.engine.step import Engine
from bayesnet_track.graph.checked import Calibration, CheckedGraph
from bayesnet_track.graph.checks.cameras import AnyCalibration, read_file
from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.graph.text.write import graph_sha256
from bayesnet_track.journal.codec import describe_other
from bayesnet_track.journal.writer import write_atomically
from bayesnet_track.observation import plugins
from bayesnet_track.observation.cue_files import CueFile, GivenCue, file_of
from bayesnet_track.observation.image_files import AnyMask, Mask, PictureError, read_mask
from bayesnet_track.runtime.checkpoints.origins import GivenFile, file_sha256, model_files, versions
from bayesnet_track.runtime.recording.rundir import RunDirectory, RunDirectoryError
from bayesnet_track.sources.origin import Origin

if TYPE_CHECKING:
    from bayesnet_track.runtime.results import FrameSource
    from bayesnet_track.sources.frames import Source
    from bayesnet_track.sources.scenes.library import SceneSource
    from bayesnet_track.sources.several import OpenCamera, SeveralSources


BYTES_AT = 0x10FF00
"""Private characters for bytes in names of files (PEP 383), which pydantic takes for no text."""


def hide_bytes(text: str) -> str:
    """The text with private characters for bytes that are no text."""
    return "".join(chr(BYTES_AT + ord(c) - 0xDC00) if "\udc80" <= c <= "\udcff" else c for c in text)


def restore_bytes(text: str) -> str:
    """The text with its bytes again: the inverse of `hide_bytes`."""
    first, final = chr(BYTES_AT + 0x80), chr(BYTES_AT + 0xFF)
    return "".join(chr(ord(c) - BYTES_AT + 0xDC00) if first <= c <= final else c for c in text)


def change_texts(value: Any, change: Callable[[str], str]) -> Any:
    """The value with every text in it changed."""
    if isinstance(value, str):
        return change(value)
    if isinstance(value, Mapping):
        return {key: change_texts(item, change) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(change_texts(item, change) for item in value)
    if is_dataclass(value) and not isinstance(value, type):
        values = {item.name: change_texts(getattr(value, item.name), change) for item in fields(value)}
        return replace(value, **values)
    return value


KEEPS_BELIEFS = "keep_beliefs"
"""The option by which a recipe says that beliefs are kept for smoothing."""

ALL_HYPOTHESES = "all_hypotheses"
"""The option by which a recipe says that hypotheses are written however many targets a frame has."""

TRACKS_CSV = "tracks_csv"
"""The option by which a recipe says that tracks.csv is written whatever the graph."""

HORIZON = "horizon"
"""The option by which a recipe says how many frames ahead targets are forecast."""

MAX_SIDE = "max_side"
"""The option by which a recipe says what the longest side of the frames is that are tracked in."""

VIDEO_FORMAT = "video"
"""The option by which a recipe says that the annotated video is `mp4`; without it, it is Matroska."""

VIDEO_SIDE = "video_side"
"""The option by which a recipe says how many px the longer side of the annotated video has at most."""


def options_of(
    engine: Engine,
    budget_ms: float | None,
    written: Collection[str],
    horizon: int = 0,
    max_side: int | None = None,
    video_side: int | None = None,
) -> dict[str, bool | int | float | str]:
    """Further options of the recipe: the budget, and what of other packages is at work.

    `written` is what the run writes besides what every run has: `beliefs`, `hypotheses`, `csv`, `mp4`.
    """
    options: dict[str, bool | int | float | str] = {}
    if budget_ms is not None:
        options["budget_ms"] = budget_ms
    if "beliefs" in written:
        options[KEEPS_BELIEFS] = True
    if "hypotheses" in written:
        options[ALL_HYPOTHESES] = True
    if "csv" in written:
        options[TRACKS_CSV] = True
    if horizon:
        options[HORIZON] = horizon
    if max_side is not None:
        options[MAX_SIDE] = max_side
    if video_side is not None:
        options[VIDEO_SIDE] = video_side
    if "mp4" in written:
        options[VIDEO_FORMAT] = "mp4"
    named: set[str] = set()
    for compiled in engine.plates.values():
        named |= {choice.cue for _, _, choice in compiled.plate.spec.cue_choices()}
        if compiled.lifecycle is not None and compiled.lifecycle.birth is not None:
            named.add(compiled.lifecycle.birth.detector.detector)
    theirs = sorted(named & plugins.allowed())
    if theirs:
        options["allow_plugins"] = ",".join(theirs)
    return options


RECIPE_VERSION = 1


class RecipeError(ValueError):
    """A ``run.json`` that is not there, not of this version, or does not go with what lies beside it."""


@dataclass(frozen=True)
class Recipe:
    """Everything that was asked for.

    Attributes:
        graph: name of the graph, whose text is in graph.yaml.
        graph_sha256: of its canonical text.
        origin: how the source was opened, and what it held.
        starts: start boxes; empty where the graph has births.
        seed: seed of all randomness.
        detections: the file of detections for births by them, or None.
        camera_detections: of several cameras, name -> its file of detections.
        inputs: the file of what came from outside in a run that was repeated, or None.
        has_video: whether the annotated video was asked for.
        own_motion: whether a motion model of one's own stood in for the graph's.
        cue_files: cue name -> the file that declares it, of the cues that come from files.
        own_cues: names of the cues that were given as objects of a program.
        masks: images of the graph's factors, by their paths as the graph has them.
        calibrations: files of its cameras, by path and name as the graph has them.
        models: files that agents and detectors read, such as networks, by their paths as the graph has them.
        options: what else was asked for, by name: `budget_ms`; `allow_plugins`, what of other packages was at
            work (to be named here allows nothing); `manifest`, that the run is finished by one;
            `keep_beliefs`; `all_hypotheses`; `tracks_csv`; `horizon`; `max_side`; `video`.
        versions: library -> version.
        recipe: version of this format.
    """

    graph: str
    graph_sha256: str
    origin: Origin
    starts: tuple[Start, ...] = ()
    seed: int = 0
    detections: GivenFile | None = None
    inputs: GivenFile | None = None
    has_video: bool = False
    own_motion: bool = False
    cue_files: Mapping[str, GivenFile] = field(default_factory=dict)
    own_cues: tuple[str, ...] = ()
    masks: Mapping[str, GivenFile] = field(default_factory=dict)
    calibrations: Mapping[str, GivenFile] = field(default_factory=dict)
    models: Mapping[str, GivenFile] = field(default_factory=dict)
    camera_detections: Mapping[str, GivenFile] = field(default_factory=dict)
    options: Mapping[str, bool | int | float | str] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=versions)
    recipe: int = RECIPE_VERSION

    @property
    def sha256(self) -> str:
        """Of the text that `write` writes."""
        return hashlib.sha256(self.text().encode()).hexdigest()

    @property
    def only_once(self) -> str | None:
        """The reason why the same cannot be done again from the run directory alone; None if it can."""
        if self.own_motion:
            return "it was tracked with a motion model of one's own"
        if self.own_cues:
            return f"it was tracked with cues of a program of one's own: {', '.join(self.own_cues)}"
        return self.origin.only_once

    @property
    def detection_files(self) -> dict[str, GivenFile]:
        """Camera -> its file of detections; "" of the one file of one image."""
        return {**({} if self.detections is None else {"": self.detections}), **self.camera_detections}

    @property
    def optional(self) -> tuple[str, ...]:
        """Files that the recorder writes besides what every run has."""
        kind = str(self.options.get(VIDEO_FORMAT, "video"))
        requested = {kind: self.has_video, "beliefs": bool(self.options.get(KEEPS_BELIEFS))}
        requested["hypotheses"] = bool(self.options.get(ALL_HYPOTHESES))
        requested["csv"] = bool(self.options.get(TRACKS_CSV))
        return tuple(name for name, is_asked in requested.items() if is_asked)

    @property
    def horizon(self) -> int:
        """Number of frames ahead for which targets are forecast; 0 for none."""
        return int(self.options.get(HORIZON, 0))

    @property
    def max_side(self) -> int | None:
        """Longest side of the frames that are tracked in, px; None for the source's own size."""
        side = self.options.get(MAX_SIDE)
        return None if side is None else int(side)

    @property
    def video_side(self) -> int | None:
        """Longest side of the annotated video, px; None where none was asked for."""
        side = self.options.get(VIDEO_SIDE)
        return None if side is None else int(side)

    @property
    def budget_ms(self) -> float | None:
        """Milliseconds that a frame might take; None for as long as it took."""
        budget = self.options.get("budget_ms")
        return None if budget is None else float(budget)

    def text(self) -> str:
        """It as JSON."""
        plain = _codec().dump_python(self)
        for name in ("cue_files", "own_cues", "masks", "calibrations", "models", "camera_detections"):
            if not plain[name]:  # as a recipe was before there were any
                del plain[name]
        usual_values: dict[str, Any] = {"stride": 1, "value_range": None, "size": None, "lazy": False}
        usual_values |= {"cameras": {}}
        for origin in (plain["origin"], *plain["origin"]["cameras"].values()):
            for name, default in usual_values.items():
                if origin[name] == default:
                    del origin[name]
        return json.dumps(plain, indent=1) + "\n"

    def write(self, directory: RunDirectory | str | PathLike[str]) -> None:
        """Write it into a run directory, whole or not at all.

        Raises:
            OutputError: it cannot be written.
        """
        write_atomically(_directory(directory).recipe, self.text().encode("utf-8"))

    @classmethod
    def read(cls, directory: RunDirectory | str | PathLike[str]) -> Recipe:
        """The recipe of the run in a directory.

        Raises:
            RecipeError: there is none, or it is damaged or of another version.
        """
        path = _directory(directory).recipe
        try:
            text = path.read_bytes()
        except FileNotFoundError:
            fault = "no such folder" if not path.parent.is_dir() else f"no {path.name} in it"
            raise RecipeError(f"{path.parent}: {fault}: not a run that can be done again") from None
        except OSError as error:
            raise RecipeError(f"{path}: {error.strerror}") from error
        try:
            plain = json.loads(text)
            _check_format(path, plain)
            plain = change_texts(plain, hide_bytes)
            recipe: Recipe = change_texts(_codec().validate_python(plain), restore_bytes)
        except RecipeError:
            raise
        except (ValueError, RecursionError) as error:
            raise RecipeError(
                f"{path}: not the recipe of a run: {' '.join(str(error).split())[:300]}"
            ) from None
        return recipe

    def open_source(self, open_camera: OpenCamera | None = None) -> Source | SceneSource | SeveralSources:
        """The same source again, from its first frame on; each of several cameras by `open_camera`.

        Raises:
            SourceError: it could be read only once, or it is gone.
            CalibrationError: the pair's calibration file cannot be used.
        """
        from bayesnet_track.sources.several import reopen

        return reopen(self.origin, open_camera)

    def read_masks(self) -> dict[str, Mask]:
        """Images of the graph's factors as they are now, by their paths in it; without what is gone."""
        masks = {}
        for name, file in self.masks.items():
            with suppress(PictureError):
                masks[name] = read_mask(file.place)
        return masks

    def read_calibrations(self, spec: GraphSpec) -> dict[str, Calibration]:
        """Cameras of the graph as their files are now, by path and name in it; any for one that is gone."""
        calibrations = {}
        for source in spec.cameras.values():
            file = self.calibrations.get(source.key)
            if file is not None:
                calibrations[source.key] = AnyCalibration()[source.key]
                with suppress(ValueError, OSError):
                    calibrations[source.key] = read_file(file.place, source.name)
        return calibrations

    @contextmanager
    def opened(self, open_camera: OpenCamera | None = None) -> Iterator[FrameSource]:
        """The same source again, let go of at the end; as `open_source`."""
        source = self.open_source(open_camera)
        try:
            yield source
        finally:
            close_source = getattr(source, "close", None)
            if close_source is not None:
                close_source()

    def load_graph(
        self, directory: RunDirectory | str | PathLike[str], cues: Iterable[GivenCue] = ()
    ) -> CheckedGraph:
        """The graph of the run in a directory; `cues` as of `load_graph`.

        Raises:
            GraphError: every error of it.
            RecipeError: it is another than the one that the run began with.
            RunDirectoryError: it cannot be read.
        """
        path = _directory(directory).graph
        try:
            text = path.read_text("utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise RunDirectoryError(f"{path}: cannot be read: {error}") from error
        if graph_sha256(text) != self.graph_sha256:
            raise RecipeError(f"{path}: another graph than the one that the run began with")
        masks = {name: AnyMask()[name] for name in self.masks} | self.read_masks()
        spec, positions = read_graph(text, str(path))
        return check(spec, positions, tuple(cues), masks, self.read_calibrations(spec))


def _check_format(path: Path, plain: object) -> None:
    """Refuse a recipe of another format; raises RecipeError."""
    if not isinstance(plain, dict) or plain.get("recipe", RECIPE_VERSION) == RECIPE_VERSION:
        return
    problem = f"format {str(plain['recipe'])[:20]} of run.json; this version reads format {RECIPE_VERSION}"
    raise RecipeError(f"{path}: {describe_other(problem, plain.get('versions'))}")


def make_recipe(
    graph: CheckedGraph,
    source: FrameSource,
    starts: Sequence[Start],
    seed: int = 0,
    *,
    detections: Mapping[str, str | PathLike[str]] = MappingProxyType({}),
    inputs: str | PathLike[str] | None = None,
    has_video: bool = False,
    own_motion: bool = False,
    options: Mapping[str, bool | int | float | str] = MappingProxyType({}),
) -> Recipe:
    """The recipe of a run that is about to begin; files are read for their fingerprints.

    Raises:
        OSError: a file cannot be read.
    """
    origin: Origin | None = getattr(source, "origin", None)
    files = {name: file_of(declaration) for name, declaration in graph.cues.items()}
    return Recipe(
        graph=graph.spec.name,
        graph_sha256=graph_sha256(graph.text),
        origin=(Origin("own", "", source.description) if origin is None else origin.marked()),
        starts=tuple(
            Start(
                tuple(float(v) for v in start.box),  # type: ignore[arg-type]
                start.plate,
                {camera: tuple(float(v) for v in numbers) for camera, numbers in start.points.items()},
            )
            for start in starts
        ),
        seed=seed,
        detections=given_file(detections[""]) if "" in detections else None,
        camera_detections={camera: given_file(path) for camera, path in detections.items() if camera},
        inputs=None if inputs is None else given_file(inputs),
        has_video=has_video,
        own_motion=own_motion,
        cue_files={name: _given_cue(file) for name, file in files.items() if file is not None},
        own_cues=tuple(name for name, file in files.items() if file is None),
        masks={
            name: GivenFile(str(mask.path), str(mask.path.absolute()), mask.sha256)
            for name, mask in sorted(graph.masks.items())
        },
        calibrations={
            name: GivenFile(str(calibration.path), str(calibration.path.absolute()), calibration.sha256)
            for name, calibration in sorted(graph.calibrations.items())
        },
        models={path: given_file(path) for path in model_files(graph)},
        options=dict(sorted(options.items())),
    )


def _given_cue(file: CueFile) -> GivenFile:
    """The file of a cue, as it was read."""
    return GivenFile(file.path, str(Path(file.path).absolute()), file.sha256)


def _directory(place: RunDirectory | str | PathLike[str]) -> RunDirectory:
    return place if isinstance(place, RunDirectory) else RunDirectory(Path(place))


@cache
def _codec() -> Any:
    from pydantic import TypeAdapter

    return TypeAdapter(Recipe)


def given_file(path: str | PathLike[str]) -> GivenFile:
    """A file as it is now; raises OSError when it cannot be read."""
    return GivenFile(str(path), str(Path(path).absolute()), file_sha256(path))
