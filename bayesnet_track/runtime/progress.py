"""The progress line: rate, time left, active agents, UD and status. The time is passed in, never read."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Mapping, Sequence
from typing import TextIO

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
        self._last = ""

    def update(self, now: float, done: int, active: Sequence[str], ud_px2: float, status: str) -> None:
        """Tell that `done` frames are ready at time `now` (seconds, any origin); shows it when it is due."""
        finite = round(ud_px2, 1) if abs(ud_px2) < float("inf") else None
        self.advance(
            now,
            done,
            f"{', '.join(active) or 'none'} | UD {ud_px2:.0f} px² | {status}",
            {"active": list(active), "ud_px2": finite, "status": status},
        )

    def advance(self, now: float, done: int, text: str, values: Mapping[str, object]) -> None:
        """Tell it with `text` behind the rate, or with `values` in the JSON object."""
        if self._shown_at is None:
            self._shown_at = now
        self._recent.append((now, done))
        self._updates += 1
        if self._updates == 3:  # between the first two, kernels may have been compiled
            self._recent.popleft()
        while len(self._recent) > 2 and self._recent[1][0] <= now - RATE_WINDOW_S:
            self._recent.popleft()
        self._last = self._line(done, text, values)
        if now - self._shown_at >= self._every:
            self._shown_at = now
            self._show()

    def finish(self) -> None:
        """Show the last state and end the line."""
        if self._last:
            self._show()
            if self._redraws:
                self._stream.write("\n")
            self._stream.flush()

    def rate(self) -> float | None:
        """Frames per second over the last five seconds; None before three updates."""
        if self._updates < 3 or len(self._recent) < 2:
            return None
        (began, first), (ended, last) = self._recent[0], self._recent[-1]
        return (last - first) / (ended - began) if ended > began else None

    def _line(self, done: int, text: str, values: Mapping[str, object]) -> str:
        rate = self.rate()
        left = (self._total - done) / rate if self._total is not None and rate else None
        if self._log_json:
            return json.dumps(
                {
                    "progress": done,
                    "total": self._total,
                    "fps": None if rate is None else round(rate, 1),
                    "left_s": None if left is None else round(max(left, 0.0), 1),
                    **values,
                }
            )
        of_total = "" if self._total is None else f"/{self._total}"
        speed = "-" if rate is None else f"{rate:.1f}"
        remaining = "" if left is None else f" | {_clock(max(left, 0.0))} left"
        return f"frame {done}{of_total} | {speed} fps{remaining} | {text}"

    def _show(self) -> None:
        if self._redraws:
            self._stream.write("\r" + self._last.ljust(self._width))
            self._width = len(self._last)
        else:
            self._stream.write(self._last + "\n")
        self._stream.flush()


def _clock(seconds: float) -> str:
    """Seconds as h:mm:ss or m:ss."""
    whole = round(seconds)
    hours, minutes = divmod(whole // 60, 60)
    return f"{hours}:{minutes:02d}:{whole % 60:02d}" if hours else f"{minutes}:{whole % 60:02d}"
