"""A live view: the page of a run in progress, and the controls on it."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from types import TracebackType
from typing import Any, Self

from bayesnet_track.engine.starts import Start, check_given
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.journal.events.event import Event, Input
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.live_view.controls import POLL_S, Controls, GiveUp, never
from bayesnet_track.runtime.live_view.feed import Feed, Thumbnails
from bayesnet_track.runtime.live_view.server import Server
from bayesnet_track.runtime.results import FrameSource, Result
from bayesnet_track.view.run_page import live_page

AT_A_TIME = 400_000
"""Bytes of lines in one answer."""

GATHER_S, WAIT_S = 0.1, 3.0
"""Seconds between two answers to the same page: at least, where little is new, and at most."""

GONE_S = 4.0
"""Seconds without a question after which no page is open."""


class LiveView:
    """Serves the page of a run in progress; give it to `track` among its `sinks` and as its `inputs`.

    Args:
        host: address to listen at; if it is not one of this machine alone, others can control the run.
        port: port to listen at; None for a free one.

    Raises:
        OSError: the port is taken, or the host is not one of this machine.

    ::

        with LiveView() as view:
            print(view.address)
            view.shows(graph)
            for result in track(graph, "video.mp4", box, sinks=[view], inputs=view):
                if view.hold():  # waits while paused; True when stopped on the page
                    break
    """

    def __init__(self, host: str = "127.0.0.1", port: int | None = None) -> None:
        self.controls = Controls()
        self._news = self.controls.news
        self._thumbnails = Thumbnails(self._notify)
        self._feed = Feed(self._news, self._thumbnails)
        self._about: dict[str, Any] = {}
        self._asking, self._asked = 0, -GONE_S
        self._page = live_page()
        self._server = Server(self, host, port)

    @property
    def address(self) -> str:
        """The address of the page, with its token."""
        return self._server.address

    @property
    def is_open(self) -> bool:
        """True if a page asked for news within the last seconds."""
        with self._news:
            return self._asking > 0 or time.monotonic() - self._asked < GONE_S

    def shows(self, graph: CheckedGraph, source: FrameSource | None = None, **details: Any) -> None:
        """Show, before the first frame is done, the graph, the source's name and size."""
        self._feed.graph = graph
        with self._news:
            self._about |= {"graph": graph.spec.name, "plates": list(graph.targets), **details}
            if source is not None:
                size = {"width": source.width, "height": source.height}
                self._about |= {"source": source.description, "expected": source.expected_frames, **size}
            self.controls.version += 1
            self._news.notify_all()

    def recall(
        self, events: Iterable[Event], metrics: Iterable[FrameMetrics], timings: Iterable[Mapping[str, Any]]
    ) -> None:
        """Show the past of a run that goes on, as its files have it, without pictures."""
        self._feed.recall(events, metrics, timings)

    def wait_for_page(self, give_up: GiveUp = never) -> bool:
        """Wait until the page is opened; whether it was."""
        while not self.is_open and not give_up():
            time.sleep(POLL_S)
        return self.is_open

    def choose(
        self, graph: CheckedGraph, source: FrameSource, first: Frame, give_up: GiveUp = never
    ) -> tuple[Start, ...] | None:
        """The boxes that a person draws on the first frame; None when there are none to come."""
        self._thumbnails.offer(first.index, first.image, must=True)
        with self._news:
            self._about["first"] = first.index
        return self.controls.choose(
            partial(check_given, graph, width=source.width, height=source.height), give_up
        )

    def event(self, event: Event) -> None:
        """A sink's: the page learns of it."""
        self._feed.event(event)

    def frame(self, result: Result) -> None:
        """A sink's: the page learns of it."""
        self._feed.frame(result)

    def __call__(self, frame: int) -> Sequence[Input]:
        """Switches that were set on the page since the frame before."""
        return self.controls.board(frame)

    def hold(self, give_up: GiveUp = never) -> bool:
        """Between two frames: wait while the run is paused on the page; whether it was stopped there."""
        return self.controls.hold(give_up, self._feed.show_newest)

    def linger(self, give_up: GiveUp = never) -> None:
        """The run has ended: stay for as long as a page is open."""
        self.controls.to("ended")
        while self.is_open and not self.controls.is_left and not give_up():
            time.sleep(POLL_S)

    def close(self) -> None:
        """Serve no more."""
        self._server.close()
        self._thumbnails.close()
        self._feed.lines.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # What the server asks for.

    def page(self) -> tuple[bytes, str]:
        """The page, and its content security policy."""
        return self._page

    def feed(self, first: int, version: int) -> bytes:
        """Lines from number `first` on, with how things stand; waits for a while where nothing is new."""
        began = time.monotonic()
        with self._news:
            self._asking += 1
        try:
            lines = self._lines(first, version, began)
        finally:
            with self._news:
                self._asking -= 1
                self._asked = time.monotonic()
        status = json.dumps({"next": first + len(lines), **self._status()})
        return b'{"status":' + status.encode() + b',"lines":[' + b",".join(lines) + b"]}"

    def picture(self, frame: int) -> tuple[int, bytes] | None:
        """The picture of a frame, or of one before it."""
        return self._thumbnails.of(frame)

    def ask(self, request: Mapping[str, Any]) -> None:
        """Do what a person asks for on the page; raises Refused."""
        self.controls.ask(request)

    def _lines(self, first: int, version: int, began: float) -> list[bytes]:
        buffer, controls = self._feed.lines, self.controls
        with self._news:
            self._news.wait_for(lambda: len(buffer) > first or controls.version != version, WAIT_S)
            if controls.version == version:
                # Few answers that say much, not many that say little.
                self._news.wait_for(
                    lambda: controls.version != version, max(0.0, began + GATHER_S - time.monotonic())
                )
        return buffer.read(first, AT_A_TIME)

    def _status(self) -> dict[str, Any]:
        with self._news:
            controls, feed = self.controls, self._feed
            return {
                "version": controls.version,
                "phase": controls.phase,
                "stopping": controls.has_stopped,
                "canSwitch": controls.can_switch,
                "rate": round(feed.rate, 2),
                "frames": feed.frames,
                "pictured": self._thumbnails.newest,
                "trouble": feed.trouble,
                "about": self._about,
            }

    def _notify(self) -> None:
        """There is a new picture: who looks at one that rests has waited for it."""
        with self._news:
            if self.controls.phase != "running":
                self.controls.version += 1
                self._news.notify_all()
