"""A machine-learning backend for Label Studio: a box is tracked on, until it is unsure.

`create_app` makes the Flask application of label-studio-ml; `Predictor` does the work, without it.
"""

from __future__ import annotations

import inspect
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from statistics import fmean
from typing import Any

from bayesnet_track.engine.starts import StartError
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.runtime.annotation.answers import by_target
from bayesnet_track.runtime.annotation.asking import PATIENCE, THRESHOLD, Asking, annotate_target
from bayesnet_track.runtime.annotation.formats.document import MismatchError
from bayesnet_track.runtime.annotation.formats.label_studio import check_frames, key_frames, read_key_frames
from bayesnet_track.runtime.annotation.formats.rows import answers_of
from bayesnet_track.runtime.annotation.frame_store import FrameStore, Video
from bayesnet_track.runtime.annotation.fusing import How, Mark
from bayesnet_track.runtime.annotation.tracked import TrackerRuns
from bayesnet_track.sources.entrances.notices import notice
from bayesnet_track.sources.sources import open_source

Json = Mapping[str, Any]
KeyFrame = tuple[object, ...]


def create_app(
    graph: str = "general",
    threshold: float = THRESHOLD,
    patience: int = PATIENCE,
    seed: int = 0,
    key: str = "video",
    max_side: int | None = None,
) -> Any:
    """The Flask application of the backend; docs/annotate.md says how to start it.

    Args:
        graph: what tracks.
        threshold: a region ends where the probability of being on target stays below this.
        patience: how many frames in a row it may be below.
        seed: of all randomness.
        key: where a task's data has the video.
        max_side: longest side of the frames that are tracked in, px; see `Tracker`.
    """
    predictor = Predictor(load_graph(graph), Asking(threshold, patience), seed, max_side)
    base = import_module("label_studio_ml.model").LabelStudioMLBase
    made = type("BayesnetTrack", (_Model, base), {"predictor": predictor, "key": key})
    return import_module("label_studio_ml.api").init_app(model_class=made)


class _Model:
    """What label-studio-ml calls; its base class brings `get_local_path`."""

    predictor: Predictor
    key: str

    def predict(
        self, tasks: Sequence[Json], context: Json | None = None, **_: object
    ) -> list[dict[str, Any]]:
        """The regions of the context, tracked; no prediction while nobody has drawn a box."""
        drawn = (context or {}).get("result") or []
        if not drawn or not tasks:
            return []
        task = tasks[0]
        if not isinstance(task["data"].get(self.key), str):
            raise MismatchError(
                f"task {task.get('id')}: no {self.key!r} in its data, which has {', '.join(task['data'])}; "
                "name the one that has the video: create_app(key=...)"
            )
        local: Any = self.get_local_path  # type: ignore[attr-defined]
        known = {"task_id": task.get("id")} if "task_id" in inspect.signature(local).parameters else {}
        path = str(local(task["data"][self.key], **known))
        return [self.predictor.predict(path, str(task.get("id")), drawn)]


@dataclass
class Predictor:
    """Tracks the regions of a video, which stays decoded until another one is asked for."""

    graph: CheckedGraph
    asking: Asking = field(default_factory=Asking)
    seed: int = 0
    max_side: int | None = None
    _video: tuple[str, float] | None = None
    _store: FrameStore | None = None
    _runs: TrackerRuns | None = None
    _made: dict[tuple[str, str], dict[KeyFrame, How]] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def predict(self, path: str, task: str, drawn: Sequence[Json]) -> dict[str, Any]:
        """A prediction of Label Studio: the regions drawn in the video of a task, with key frames added.

        Key frames that an earlier prediction made are tracked anew, unless somebody has changed them since. A
        region from which no tracker can start stays as it was drawn, with a notice; the others are tracked.

        Raises:
            MismatchError: a region does not fit the video.
            SourceError: the video cannot be read.
        """
        with self._lock:
            video, runs = self._opened(path)
            regions, sure = [], list[float]()
            for number, region in enumerate(drawn):
                if region.get("type") == "videorectangle":
                    key = task, str(region.get("id", number))
                    try:
                        marks = self._track(region, key, video, runs)
                    except StartError as error:
                        notice(f"{path}, region {key[1]}: it stays as drawn: {error}")
                        regions.append(dict(region))
                        continue
                    regions.append(self._region(region, key, video, marks))
                    sure += [mark.probability for mark in marks.values() if mark.how != "given"]
        score = round(fmean(sure), 4) if sure else 1.0
        return {
            "model_version": f"bayesnet-track {version('bayesnet-track')}",
            "score": score,
            "result": regions,
        }

    def close(self) -> None:
        """Let go of the decoded video."""
        if self._store is not None:
            self._store.close()
        self._video = self._store = self._runs = None

    def _opened(self, path: str) -> tuple[Video, TrackerRuns]:
        key = (path, Path(path).stat().st_mtime if Path(path).exists() else 0.0)
        if self._store is None or self._runs is None or key != self._video:
            self.close()
            with open_source(path) as source:
                self._store = FrameStore.of(source, path, source.frame_interval_s)
            self._runs = TrackerRuns(self.graph, self._store, self.seed, self.max_side)
            self._video = key
        return self._store.about(), self._runs

    def _track(
        self, region: Json, key: tuple[str, str], video: Video, runs: TrackerRuns
    ) -> Mapping[int, Mark]:
        place, made = f"region {key[1]}", self._made.get(key, {})
        check_frames(region["value"].get("framesCount", video.frames), video, f"{place}, framesCount")
        given = []
        for one in region["value"]["sequence"]:
            how = made.get(_identity(one))
            if how is None:
                given.append(one)
            elif how == "given":  # it ended the region because of what came after it
                given.append({**one, "enabled": True})
        task = Path(f"task {key[0]}")
        rows = read_key_frames(given, (key[1], key[1]), video, place, task)
        answers = by_target(answers_of(rows, video, task, {key[1]: key[1]})).get(key[1], ())
        if not answers:
            return {}
        marks, _ = annotate_target(key[1], answers, runs, video.frames, self.asking)
        last = answers[-1].frame
        while max(marks) > last and marks[max(marks)].probability < self.asking.threshold:
            del marks[max(marks)]  # where it is unsure to the end, somebody draws the next box
        return marks

    def _region(
        self, region: Json, key: tuple[str, str], video: Video, marks: Mapping[int, Mark]
    ) -> dict[str, Any]:
        sequence = [*key_frames(marks, video)]
        hows = {frame: mark.how for frame, mark in marks.items()}
        self._made[key] = {
            _identity(one): hows[one["frame"] - 1]
            for one in sequence
            if hows[one["frame"] - 1] != "given" or hows.get(one["frame"]) != "gone"
        }
        value = {
            "framesCount": video.frames,
            "duration": video.frames * video.frame_interval_s,
            **region["value"],
            "sequence": sequence,
        }
        return {**region, "value": value, "origin": "prediction"}


def _identity(one: Json) -> KeyFrame:
    """What is the same of a key frame that nobody has changed."""
    sides = (round(float(one[name]), 3) for name in ("x", "y", "width", "height"))
    return (int(one["frame"]), bool(one.get("enabled", True)), *sides)
