"""A run as a Rerun recording: pictures, boxes, clouds, UD and KL over time, and every event as a text."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from bayesnet_track.journal.codec import event_name
from bayesnet_track.journal.disk import is_there
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.runs import RunEnded
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.text.sentences import explain
from bayesnet_track.journal.writer import OutputError
from bayesnet_track.numerics.boxes import corner_from_centre
from bayesnet_track.observation.settings import setting
from bayesnet_track.runtime.results import Result

JPEG_QUALITY = 85
COLOURS = {
    "tracking": (60, 200, 90),
    "uncertain": (240, 180, 40),
    "hidden": (150, 130, 200),
    "lost": (230, 70, 60),
}
SERIOUS = ("quarantined", "source_damaged", "detector_failed", "degenerate_belief", "target_died")


class RerunError(OutputError):
    """Rerun cannot be used, with the cure."""


@contextmanager
def rerun_sinks(file: str | None, name: str, overwrite: bool = False) -> Iterator[list[RerunSink]]:
    """The sinks that the option `--rerun` asks for: none for None, the viewer for an empty text, else a file.

    Raises:
        RerunError: as `RerunSink`, or the file is there and not to be overwritten.
    """
    if file is None:
        yield []
        return
    try:
        exists = bool(file) and is_there(Path(file))
    except OSError as error:  # a name that is too long
        raise RerunError(f"Rerun cannot open {file}: {error.strerror}") from error
    if exists and not overwrite:
        raise RerunError(f"{file}: it is there already; {setting('--overwrite')} replaces it")
    sink = RerunSink(Path(file) if file else None, name)
    try:
        yield [sink]
    finally:
        sink.close()


class RerunSink:
    """Logs every frame and event of a run to a Rerun recording; a sink of `track` and `run`.

    Args:
        path: file to write (.rrd); the viewer is opened when None.
        name: what the recording is called.

    Raises:
        RerunError: Rerun is not installed, or the file or the viewer cannot be opened.

    Timelines `frame` and `time`; entities `video`, `video/<target>/{box,cloud}`, `ud/<target>`,
    `score/<target>`, `kl/<target>/<agent>`, `events`. UD in px^2, KL in nats.
    """

    def __init__(self, path: Path | None, name: str = "bayesnet_track") -> None:
        try:
            self._rerun: Any = import_module("rerun")
        except ImportError as error:
            raise RerunError(
                "Rerun is not installed; pip install 'bayesnet-track[rerun]', or pip install rerun-sdk"
            ) from error
        if not hasattr(self._rerun, "RecordingStream") or not hasattr(self._rerun, "Scalars"):
            raise RerunError(
                "this Rerun is too old, or another package of the name; pip install -U rerun-sdk"
            )
        self._recording = self._rerun.RecordingStream(name)
        try:
            if path is None:
                self._recording.spawn()
            else:
                # Rerun says nothing of a folder that is not there.
                path.parent.mkdir(parents=True, exist_ok=True)
                path.open("wb").close()
                self._recording.save(path)
        except (OSError, RuntimeError) as error:
            noun = "the viewer" if path is None else str(path)
            raise RerunError(f"Rerun cannot open {noun}: {error}") from error
        self._events: list[Event] = []
        self._shown: set[str] = set()

    def event(self, event: Event) -> None:
        """Keep an event for its frame, or log it where it is the last."""
        if isinstance(event, RunEnded):
            self._log_event(event)
        else:
            self._events.append(event)

    def frame(self, result: Result) -> None:
        """Log one frame."""
        self._recording.set_time("frame", sequence=result.frame.index)
        if result.targets:
            self._recording.set_time("time", duration=result.targets[0].time_s)
        self._picture(result)
        for event in self._events:
            self._log_event(event)
        self._events.clear()
        for metrics in result.targets:
            self._target(metrics)
        live = {metrics.target for metrics in result.targets}
        for target in self._shown - live:
            self._recording.log(["video", target], self._rerun.Clear(recursive=True))
        self._shown = live

    def close(self) -> None:
        """Hand the rest to the file or the viewer."""
        self._recording.flush()
        self._recording.disconnect()

    def _picture(self, result: Result) -> None:
        import cv2

        quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
        is_encoded, jpeg = cv2.imencode(".jpg", result.frame.image, quality)
        if is_encoded:
            encoded = self._rerun.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg")
            self._recording.log("video", encoded)

    def _target(self, metrics: FrameMetrics) -> None:
        rerun, log, target = self._rerun, self._recording.log, metrics.target
        x, y, w, h = corner_from_centre(metrics.centre_box)
        colour = COLOURS.get(metrics.status, (200, 200, 200))
        label = f"{target} {metrics.status} {metrics.score:.2f}: {', '.join(metrics.active)}"
        log(
            ["video", target, "box"],
            rerun.Boxes2D(mins=[(x, y)], sizes=[(w, h)], labels=[label], colors=[colour]),
        )
        if metrics.cloud:
            # Rerun counts from the corner of the first pixel, hypotheses from its centre.
            points = np.asarray(metrics.cloud, dtype=np.float64)[:, :2] + 0.5
            log(["video", target, "cloud"], rerun.Points2D(points, radii=1.5, colors=[colour]))
        log(["ud", target], rerun.Scalars(metrics.ud_px2))
        log(["score", target], rerun.Scalars(metrics.score))
        for agent, kl in metrics.kl.items():
            log(["kl", target, agent], rerun.Scalars(kl))

    def _log_event(self, event: Event) -> None:
        level = "WARN" if event_name(type(event)) in SERIOUS else "INFO"
        self._recording.log("events", self._rerun.TextLog(explain(event, name_target=True), level=level))
