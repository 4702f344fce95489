"""What a person who watches asks of a run: begin with these boxes, wait, take one frame, switch, stop."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from bayesnet_track.engine.starts import Start, StartError
from bayesnet_track.runtime.results import Switchboard

POLL_S = 0.05
"""Seconds between two looks for what gives no notice, such as a signal."""

Check = Callable[[Sequence[Start]], None]
GiveUp = Callable[[], bool]


class Refused(ValueError):
    """A request that makes no sense, or not now; the message is for the person."""


def never() -> bool:
    """Nothing but the person ends the wait."""
    return False


class Controls:
    """Asked from any thread; the run takes it between two frames.

    Attributes:
        news: notified whenever something of it changes.
        board: switches of agents, for `run(..., external_inputs=...)`.
        phase: opening (no frame yet), choosing (of start boxes), ready (waits for a person to begin),
            starting, running, paused or ended.
        version: counts changes of it all.
        can_switch: whether agents may be switched.
        has_stopped: whether a person stopped the run.
        is_left: whether a person closed the view.
    """

    def __init__(self) -> None:
        self.news = threading.Condition()
        self.board = Switchboard()
        self.phase = "opening"
        self.version = 0
        self.can_switch = True
        self.has_stopped = self.is_left = False
        self._is_paused = False
        self._steps = 0
        self._check: Check | None = None
        self._starts: tuple[Start, ...] | None = None

    def to(self, phase: str) -> None:
        """The run is in another phase."""
        with self.news:
            self.phase = phase
            self._change()

    def choose(self, check: Check, give_up: GiveUp = never) -> tuple[Start, ...] | None:
        """Wait for start boxes that `check` lets pass; None when the person stopped, or on `give_up`."""
        with self.news:
            self._check, self._starts = check, None
            self.to("choosing")
            self._wait(lambda: self._starts is not None or self.has_stopped, give_up)
            self._check = None
            if self._starts is not None:
                self.to("starting")
            return self._starts

    def hold(self, give_up: GiveUp = never, resting: Callable[[], None] = lambda: None) -> bool:
        """Between two frames: wait while paused, `resting`; whether a person stopped the run."""
        with self.news:
            if self._is_paused and not self._steps:
                self.to("paused")
                resting()
                self._wait(lambda: not self._is_paused or self._steps > 0 or self.has_stopped, give_up)
            self._steps = max(0, self._steps - 1)
            if not self._is_paused and self.phase != "running":
                self.to("running")
            return self.has_stopped

    def ask(self, request: Mapping[str, Any]) -> None:
        """Do what a page asks for: `{"do": NAME, ...}`; see the docstrings of `_do_NAME`.

        Raises:
            Refused: it cannot be done.
        """
        do = getattr(self, f"_do_{request.get('do')}", None)
        if do is None:
            raise Refused("no such thing to do")
        with self.news:
            do(request)
            self._change()

    def _do_pause(self, request: Mapping[str, Any]) -> None:
        """Wait behind the frame that is under way."""
        self._is_paused, self._steps = True, 0

    def _do_go(self, request: Mapping[str, Any]) -> None:
        """Go on."""
        self._is_paused, self._steps = False, 0

    def _do_step(self, request: Mapping[str, Any]) -> None:
        """Take one frame, then wait."""
        self._is_paused = True
        self._steps = min(self._steps + 1, 100)

    def _do_stop(self, request: Mapping[str, Any]) -> None:
        """End the run behind the frame that is under way."""
        self.has_stopped = True

    def _do_leave(self, request: Mapping[str, Any]) -> None:
        """Close the view, once the run has ended."""
        if self.phase != "ended":
            raise Refused("the run goes on: stop it first")
        self.is_left = True

    def _do_switch(self, request: Mapping[str, Any]) -> None:
        """`target`, `agent`, `on`: switch an agent, until it is released."""
        on = request.get("on")
        if not isinstance(on, bool):
            raise Refused("on or off?")
        self.board.switch(*self._find_named(request), on=on)

    def _do_release(self, request: Mapping[str, Any]) -> None:
        """`target`, `agent`: give an agent back to the rules."""
        self.board.release(*self._find_named(request))

    def _do_start(self, request: Mapping[str, Any]) -> None:
        """`boxes`: `[{"box": [x, y, w, h], "plate": NAME or null}, ...]`; begin with them."""
        if self._check is None:
            raise Refused("the run has begun already")
        boxes = request.get("boxes")
        if not isinstance(boxes, list) or not 1 <= len(boxes) <= 100:
            raise Refused("draw a box around what is to be tracked")
        starts = tuple(_start(entry) for entry in boxes)
        try:
            self._check(starts)
        except StartError as error:
            raise Refused(str(error)) from error
        self._starts = starts

    def _find_named(self, request: Mapping[str, Any]) -> tuple[str, str]:
        target, agent = request.get("target"), request.get("agent")
        if not self.can_switch:
            raise Refused("this run repeats an earlier one: what was switched then is switched now")
        if not (isinstance(target, str) and isinstance(agent, str)):
            raise Refused("which agent of which target?")
        if self.phase not in ("running", "paused"):
            raise Refused("the run has ended" if self.phase == "ended" else "the run has not begun")
        return target, agent

    def _wait(self, is_due: Callable[[], bool], give_up: GiveUp) -> None:
        while not is_due() and not give_up():
            self.news.wait(POLL_S)

    def _change(self) -> None:
        self.version += 1
        self.news.notify_all()


def _start(entry: Any) -> Start:
    box = entry.get("box") if isinstance(entry, dict) else None
    plate = entry.get("plate") if isinstance(entry, dict) else None
    numbers = box if isinstance(box, list) else []
    if len(numbers) != 4 or any(type(value) not in (int, float) for value in numbers):
        raise Refused("a box is four numbers x, y, w, h")
    if not (plate is None or isinstance(plate, str)):
        raise Refused("a plate is named by a text")
    try:
        x, y, w, h = (float(value) for value in numbers)
    except OverflowError as error:
        raise Refused("a box is four numbers of pixels") from error
    return Start((x, y, w, h), plate)
