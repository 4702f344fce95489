"""What a page is told of a run in progress: its header, then every event and every frame, in order."""

from __future__ import annotations

import json
import math
import threading
import time
from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any

from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.journal.codec import to_json
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.runs import RunEnded, RunStarted
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.text.explain import kinds_of
from bayesnet_track.runtime.live_view.event_buffer import EventBuffer
from bayesnet_track.runtime.live_view.thumbnails import Thumbnails
from bayesnet_track.runtime.results import Result
from bayesnet_track.view.page_data import run_data
from bayesnet_track.view.page_tables import event_row

WINDOW_S = 2.0


class Feed:
    """A sink of `run` that keeps what it is told for pages to read; it never waits for one.

    Args:
        news: notified of every line.
        thumbnails: offered the pictures.

    Attributes:
        lines: JSON texts: `{"header": ...}`, `{"event": ...}`, `{"frames": [...], "timing": ...}`,
            `{"ended": ...}`.
        frames: frames so far.
        trouble: why nothing can be kept any more; empty while all is well.
        graph: whose nets are drawn.
    """

    def __init__(self, news: threading.Condition, thumbnails: Thumbnails) -> None:
        self.lines = EventBuffer()
        self.frames = 0
        self.trouble = ""
        self.graph: CheckedGraph | None = None
        self._news, self._thumbnails = news, thumbnails
        self._newest: Result | None = None
        self._has_event = False
        self._kinds: dict[str, str] = {}
        self._moments: deque[float] = deque(maxlen=200)

    @property
    def rate(self) -> float:
        """Frames a second of late; 0 where it is not known."""
        moments = [moment for moment in list(self._moments) if moment > time.monotonic() - WINDOW_S]
        span = moments[-1] - moments[0] if moments else 0.0
        return (len(moments) - 1) / span if span > 0 else 0.0

    def event(self, event: Event) -> None:
        """A decision, a fault or a notice."""
        if isinstance(event, RunStarted):
            self._add({"header": run_data([event], (), graph=self.graph)[0]})
        elif isinstance(event, RunEnded):
            self.show_newest()
            self._add({"ended": {"complete": event.complete, "reason": event.reason}})
        else:
            self._kinds |= kinds_of([event])
            row = event_row(event, self._kinds)
            self._has_event |= row["sort"] != "note"
            self._add({"event": row})

    def frame(self, result: Result) -> None:
        """What one frame gave."""
        self.frames += 1
        self._newest = result
        self._moments.append(time.monotonic())
        self._thumbnails.offer(result.frame.index, result.frame.image, must=self._has_event)
        self._has_event = False
        spent = {name: round(seconds, 7) for name, seconds in result.seconds.items()}
        timing = {"frame": result.frame.index, "seconds": round(result.total_seconds, 7), "parts": spent}
        frames = ",".join(to_json(one) for one in result.targets)
        self._write(f'{{"frames":[{frames}],"timing":{json.dumps(timing)}}}')

    def recall(
        self, events: Iterable[Event], metrics: Iterable[FrameMetrics], timings: Iterable[Mapping[str, Any]]
    ) -> None:
        """Tell of the frames that were tracked before, by another process; they have no pictures."""
        frames: dict[int, list[str]] = {}
        for line in metrics:
            frames.setdefault(line.frame, []).append(to_json(line))
        clock = {line["frame"]: line for line in timings}
        pending = sorted(frames, reverse=True)

        def emit_up_to(frame: float) -> None:
            while pending and pending[-1] < frame:
                number = pending.pop()
                timing = clock.get(number, {"frame": number, "seconds": 0.0, "parts": {}})
                self.frames += 1
                self._write(f'{{"frames":[{",".join(frames[number])}],"timing":{json.dumps(timing)}}}')

        for event in events:
            emit_up_to(getattr(event, "frame", -math.inf))
            self.event(event)
        emit_up_to(math.inf)

    def show_newest(self) -> None:
        """See to it that the newest frame has a picture: the run rests here."""
        if self._newest is not None:
            self._thumbnails.offer(self._newest.frame.index, self._newest.frame.image, must=True)

    def _add(self, what: Mapping[str, Any]) -> None:
        self._write(json.dumps(what))

    def _write(self, text: str) -> None:
        if self.trouble:
            return
        try:
            self.lines.append(text.encode())
        except OSError as error:
            # The run goes on: who watches is told.
            self.trouble = f"the view cannot keep any more of the run: {error.strerror}"
        with self._news:
            self._news.notify_all()
