"""What happens to the frames of a source: missing, dropped, late, of another size, damaged."""

from __future__ import annotations

from dataclasses import dataclass

from bayesnet_track.journal.text.wording import plural


@dataclass(frozen=True)
class FramesMissing:
    """The source jumps in time: frames are missing before `frame`; the belief is predicted over the gap.

    Attributes:
        frame: first frame after the gap.
        missing: how many nominal frame intervals are missing.
    """

    frame: int
    missing: float

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        gap = plural(self.missing, "frame interval")
        return f"{gap} missing before it; the belief is predicted over the gap"


@dataclass(frozen=True)
class FrameSizeChanged:
    """The images change size or number of channels at this frame.

    Attributes:
        frame: the frame.
        width: new columns.
        height: new rows.
        action: stop, or rescale to the first frame's size.
    """

    frame: int
    width: int
    height: int
    action: str

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        then = "the run stops" if self.action == "stop" else "they are scaled to the first frame's size"
        return f"the frame size changes to {self.width}x{self.height}; {then}"


@dataclass(frozen=True)
class SourceDamaged:
    """The source is damaged at or before this frame.

    Attributes:
        frame: next frame to be read.
        reason: what the decoder said.
        times: how often it said so before another frame could be read.
        last: next frame to be read when it said so last; None where that was once.
    """

    frame: int
    reason: str
    times: int = 1
    last: int | None = None

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        until = "" if self.last in (None, self.frame) else f" up to frame {self.last}"
        often = "" if self.times == 1 else f", {self.times} times{until}"
        return f"the source is damaged{often}: {self.reason}"


OUTDATED = "newer ones had arrived"


@dataclass(frozen=True)
class FramesDropped:
    """Images of a live source were dropped, mostly because newer ones had arrived when the tracker was ready.

    Attributes:
        frame: next frame to be read.
        dropped: how many since the last such event.
        reason: why.
    """

    frame: int
    dropped: int
    reason: str = OUTDATED

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        return f"{plural(self.dropped, 'frame')} dropped, because {self.reason}"


@dataclass(frozen=True)
class SourceStalled:
    """A live source delivered no image for a while; the program reconnects.

    Attributes:
        frame: next frame to be read.
        seconds: wall-clock seconds since the last image.
        reason: what was wrong.
        attempt: attempts to reconnect since the last image, this one included.
    """

    frame: int
    seconds: float
    reason: str
    attempt: int

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        silent = f"source stalled for {self.seconds:.1f} s: {self.reason}"
        return f"{silent}; reconnecting, attempt {self.attempt}"


Events = FramesMissing | FrameSizeChanged | SourceDamaged | FramesDropped | SourceStalled
