"""Pace of a run: frames against a budget of time, and the progress line."""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol, TextIO

from bayesnet_track.journal.events.event import Input
from bayesnet_track.journal.events.load import LateFrame, SpareTime
from bayesnet_track.journal.net import Net

FOR_AGENTS = 0.8
"""Share of the budget by which agents that work elsewhere have to answer: the rest is for what follows."""

FOR_ONE = 0.5
"""Share of the budget for which one of them is waited for in a frame: the rest is for what others learn."""

WARM_UP = 5
"""First frames, which load what is compiled: their time says nothing."""

TOLD_EVERY = 50
"""Frames in time after which they are told of, while something is done without."""


class WaitBudget:
    """For how long agents elsewhere are waited for in one frame.

    Args:
        until: moment by which all answers are needed.
        each_s: seconds for which one agent is waited for.
    """

    def __init__(self, deadline: float, each_s: float) -> None:
        self._until, self._each_s = deadline, each_s
        self._waited: dict[str, float] = {}

    def until(self, agent: str, moment: float) -> float:
        """The moment by which the agent has to answer what it is asked `moment`.

        >>> patience = WaitBudget(10.8, 0.5)
        >>> patience.until("hue", 10.0)
        10.5
        >>> patience.waited("hue", 0.4)
        >>> round(patience.until("hue", 10.6), 9), patience.until("motion", 10.6)
        (10.7, 10.8)
        """
        return min(self._until, moment + max(self._each_s - self._waited.get(agent, 0.0), 0.0))

    def waited(self, agent: str, seconds: float) -> None:
        """The agent was waited for."""
        self._waited[agent] = self._waited.get(agent, 0.0) + seconds


class TimedExecutor(Protocol):
    """An executor of agents elsewhere that can leave out an answer that comes too late.

    Attributes:
        patience: for how long answers are waited for; a later one is never used (`AgentUnavailable`). None
            for as long as they take.
    """

    patience: WaitBudget | None


class Deadline:
    """The time that a frame may take.

    Args:
        budget_ms: milliseconds.
        asking: who asks agents elsewhere, to be told by when each frame needs their answers.
        clock: seconds of the monotonic clock.
        known_until: up to this frame it is known already what was late: nothing is told, nobody is hurried.
    """

    def __init__(
        self,
        budget_ms: float,
        asking: TimedExecutor | None = None,
        clock: Callable[[], float] = time.monotonic,
        known_until: int = -1,
    ) -> None:
        self.budget_ms, self._known_until = budget_ms, known_until
        self._is_known = False
        self._asking, self._clock = asking, clock
        self._began = 0.0
        self._frames = self._calm = 0
        self._spent = self._most = 0.0

    def begin(self) -> None:
        """A frame begins."""
        self._began = self._clock()
        if self._asking is not None and self._frames >= WARM_UP and not self._is_known:
            budget_s = self.budget_ms / 1000.0
            self._asking.patience = WaitBudget(self._began + FOR_AGENTS * budget_s, FOR_ONE * budget_s)

    def end(self) -> None:
        """The frame is done."""
        if self._asking is not None:
            self._asking.patience = None
        self._frames += 1
        self._spent = 1000.0 * (self._clock() - self._began)
        if self._frames <= WARM_UP:
            self._spent = 0.0
        is_late = self._spent > self.budget_ms
        self._calm = 0 if is_late else self._calm + 1
        self._most = 0.0 if is_late else max(self._most, self._spent)

    def inputs_for(self, frame: int, net: Net) -> tuple[Input, ...]:
        """Inputs of the engine with the next frame: that the last was late, or that there is time.

        It is asked before `begin`.
        """
        self._is_known = frame <= self._known_until
        if self._is_known:
            self._calm, self._most = 0, 0.0
            return ()
        if self._spent > self.budget_ms:
            return (LateFrame(frame, self._spent, self.budget_ms),)
        if self._calm < TOLD_EVERY:
            return ()
        spare = SpareTime(frame, self._most, self.budget_ms, self._calm)
        self._calm, self._most = 0, 0.0
        is_short = any(live.shed or live.most_particles is not None for live in net.targets.values())
        return (spare,) if is_short else ()


TERMINAL_EVERY_S = 0.1
PLAIN_EVERY_S = 5.0
RATE_WINDOW_S = 5.0


class Progress:
    """Says how far a run is.

    On a terminal one line is redrawn at most ten times a second; elsewhere a plain line is written every five
    seconds; with `log_json` these lines are JSON objects.
    """

    def __init__(self, stream: TextIO, total: int | None, is_terminal: bool, log_json: bool = False) -> None:
        self._stream, self._total, self._log_json = stream, total, log_json
        self._redraws = is_terminal and not log_json
        self._every = TERMINAL_EVERY_S if self._redraws else PLAIN_EVERY_S
        self._recent: deque[tuple[float, int]] = deque()
        self._updates = 0
        self._shown_at: float | None = None
        self._width = 0
        self._last = self._shown = ""

    def update(
        self, moment: float, frames: int, active: Sequence[str], ud_px2: float, status: str, unit: str = "px²"
    ) -> None:
        """Tell that so many `frames` are ready at `moment` (seconds, any origin); shows it when it is due.

        With an empty `unit` UD stands only in the JSON object.
        """
        digits = 1 if unit in ("", "px²") else 5
        ud_text = f"UD {ud_px2:.{digits - 1}f} {unit} | " if unit else ""
        finite = round(ud_px2, digits) if abs(ud_px2) < float("inf") else None
        self.advance(
            moment,
            frames,
            f"{', '.join(active) or 'none'} | {ud_text}{status}",
            {"active": list(active), "ud_px2": finite, "status": status},
        )

    def advance(self, moment: float, frames: int, text: str, values: Mapping[str, object]) -> None:
        """Tell it with `text` behind the rate, or with `values` in the JSON object."""
        if self._shown_at is None:
            self._shown_at = moment
        self._recent.append((moment, frames))
        self._updates += 1
        if self._updates == 3:  # between the first two, kernels may have been compiled
            self._recent.popleft()
        while len(self._recent) > 2 and self._recent[1][0] <= moment - RATE_WINDOW_S:
            self._recent.popleft()
        self._last = self._line(frames, text, values)
        if moment - self._shown_at >= self._every:
            self._shown_at = moment
            self._show()

    def finish(self) -> None:
        """Show the last state, unless it is shown, and end the line."""
        if self._last:
            if self._last != self._shown:
                self._show()
            if self._redraws:
                self._stream.write("\n")
            self._stream.flush()

    def rate(self) -> float | None:
        """Frames per second over the last five seconds; None before three updates."""
        if self._updates < 3 or len(self._recent) < 2:
            return None
        (began, first), (ended, final) = self._recent[0], self._recent[-1]
        return (final - first) / (ended - began) if ended > began else None

    def _line(self, frames: int, text: str, values: Mapping[str, object]) -> str:
        rate = self.rate()
        left_s = (self._total - frames) / rate if self._total is not None and rate else None
        if self._log_json:
            return json.dumps(
                {
                    "progress": frames,
                    "total": self._total,
                    "fps": None if rate is None else round(rate, 1),
                    "left_s": None if left_s is None else round(max(left_s, 0.0), 1),
                    **values,
                }
            )
        of_total = "" if self._total is None else f"/{self._total}"
        speed = "-" if rate is None else f"{rate:.1f}"
        remaining = "" if left_s is None else f" | {_clock(max(left_s, 0.0))} left"
        return f"frame {frames}{of_total} | {speed} fps{remaining} | {text}"

    def _show(self) -> None:
        self._shown = self._last
        if self._redraws:
            self._stream.write("\r" + self._last.ljust(self._width))
            self._width = len(self._last)
        else:
            self._stream.write(self._last + "\n")
        self._stream.flush()


def _clock(seconds: float) -> str:
    """Seconds as h:mm:ss or m:ss."""
    rounded = round(seconds)
    hours, minutes = divmod(rounded // 60, 60)
    return f"{hours}:{minutes:02d}:{rounded % 60:02d}" if hours else f"{minutes}:{rounded % 60:02d}"
