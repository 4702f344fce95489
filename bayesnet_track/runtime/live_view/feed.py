"""The page's feed of a run in progress: its header, every event and frame, small pictures."""

from __future__ import annotations

import json
import math
import tempfile
import threading
import time
from array import array
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.journal.codec import to_json
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.runs import RunEnded, RunStarted
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.text.sentences import kinds_of
from bayesnet_track.numerics.arrays import Image
from bayesnet_track.runtime.results import Result
from bayesnet_track.view.page_data import run_data
from bayesnet_track.view.page_tables import event_row


class EventBuffer:
    """Appended to by one thread, read by any. What is read was appended whole; nothing is ever skipped.

    >>> buffer = EventBuffer()
    >>> for line in (b"a", b"bc", b"d"):
    ...     buffer.append(line)
    >>> buffer.read(1, limit=2), buffer.read(1, limit=3), len(buffer)
    ([b'bc'], [b'bc', b'd'], 3)

    Raises:
        OSError: no temporary file can be made; from `append`, too, when the disk is full.
    """

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115
        self._ends = array("Q")
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._ends)

    def append(self, line: bytes) -> None:
        """Add a line behind the others."""
        with self._lock:
            end = self._ends[-1] if self._ends else 0
            # What a full disk cut off is written over.
            self._file.seek(end)
            remainder = memoryview(line)
            while remainder:
                remainder = remainder[self._file.write(remainder) :]
            self._ends.append(end + len(line))

    def read(self, first: int, limit: int) -> list[bytes]:
        """Lines from number `first` on, at most `limit` bytes together, but one at least if there is one."""
        with self._lock:
            if not 0 <= first < len(self._ends):
                return []
            begin = place = self._ends[first - 1] if first else 0
            ends: list[int] = []
            for number in range(first, len(self._ends)):
                if ends and self._ends[number] - begin > limit:
                    break
                ends.append(self._ends[number])
            self._file.seek(begin)
            data = b""
            while len(data) < ends[-1] - begin:
                data += self._file.read(ends[-1] - begin - len(data))
        lines = []
        for end in ends:
            lines.append(data[place - begin : end - begin])
            place = end
        return lines

    def close(self) -> None:
        """Let go of the file, and of the lines."""
        self._file.close()


PER_SECOND = 20.0
WAITING = 4
"""Pictures that may wait for the encoder; one that comes when so many wait is left out."""

BUDGET = 64_000_000
AREA = 640 * 480
QUALITY = 72


class Thumbnails:
    """Pictures of frames, encoded by a thread of their own. Who offers one never waits.

    Args:
        notify: called by that thread whenever there is a new one.
        budget: bytes that all may take together; beyond it, every other of the older half goes.
        per_second: how many are taken at most, besides those that must be.
    """

    def __init__(
        self,
        notify: Callable[[], None] = lambda: None,
        budget: int = BUDGET,
        per_second: float = PER_SECOND,
    ) -> None:
        self._notify, self._budget, self._pause_s = notify, budget, 1.0 / per_second
        self._news = threading.Condition()
        self._waiting: deque[tuple[int, Image]] = deque()
        self._kept: dict[int, bytes] = {}
        self._order: list[int] = []
        self._musts: set[int] = set()
        self._size, self._due, self._is_closed = 0, 0.0, False
        threading.Thread(target=self._encode, name="thumbnails", daemon=True).start()

    def offer(self, frame: int, image: Image, must: bool = False) -> None:
        """Take the picture (H, W, 3) uint8 BGR of a frame, if it is time for one or it `must` be there."""
        moment = time.monotonic()
        with self._news:
            full = len(self._waiting) >= (4 * WAITING if must else WAITING)
            if full or frame in self._kept or not (must or moment >= self._due):
                return
            self._due = moment + self._pause_s
            if must:
                self._musts.add(frame)
            self._waiting.append((frame, image))
            self._news.notify()

    def of(self, frame: int) -> tuple[int, bytes] | None:
        """The JPEG of the newest picture that is not later than `frame`, else the first, and its frame."""
        with self._news:
            if not self._order:
                return None
            number = self._order[max(0, bisect_right(self._order, frame) - 1)]
            return number, self._kept[number]

    @property
    def newest(self) -> int:
        """The last frame that has a picture; -1 where none has."""
        with self._news:
            return self._order[-1] if self._order else -1

    def close(self) -> None:
        """Encode no more."""
        with self._news:
            self._is_closed = True
            self._news.notify()

    def _encode(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._waiting or self._is_closed)
                if self._is_closed:
                    return
                frame, image = self._waiting[0]
            data = encode_jpeg(image)
            with self._news:
                self._waiting.popleft()
                if data and frame not in self._kept:
                    self._kept[frame] = data
                    self._order.insert(bisect_right(self._order, frame), frame)
                    self._size += len(data)
                    self._thin()
            self._notify()

    def _thin(self) -> None:
        """Every other of the older half goes; those that must be there only if nothing else is left to go."""
        while self._size > self._budget and len(self._order) > 2:
            half = self._order[: len(self._order) // 2]
            spare = [frame for frame in half if frame not in self._musts] or half
            for frame in spare[::2]:
                self._size -= len(self._kept.pop(frame))
            self._order = [frame for frame in self._order if frame in self._kept]


def encode_jpeg(image: Image) -> bytes:
    """A JPEG of at most about 640 x 480 px; empty where there is none."""
    import cv2

    rows, columns = image.shape[:2]
    scale = float(np.sqrt(AREA / (rows * columns)))
    if scale < 1.0:
        size = (max(1, round(columns * scale)), max(1, round(rows * scale)))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    is_encoded, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return data.tobytes() if is_encoded else b""


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
        """Append the result of a frame."""
        self.frames += 1
        self._newest = result
        self._moments.append(time.monotonic())
        self._thumbnails.offer(result.frame.index, result.frame.image, must=self._has_event)
        self._has_event = False
        spent = {name: round(seconds, 7) for name, seconds in result.seconds.items()}
        timing = {"frame": result.frame.index, "seconds": round(result.total_seconds, 7), "parts": spent}
        frames = ",".join(to_json(line) for line in result.targets)
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

    def _add(self, message: Mapping[str, Any]) -> None:
        self._write(json.dumps(message))

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
