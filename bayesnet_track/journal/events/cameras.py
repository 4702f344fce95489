"""Events of cameras: what was learnt of their clocks."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ClockLearnt:
    """The clock of a camera is much better known than at the last report, or is elsewhere.

    Attributes:
        frame: step whose evidence it is after.
        camera: the camera.
        offset_s: by how much the times of its frames are later than those of the first camera, s.
        sd_s: of the offset, s.
        before_s: the offset as it was reported last, s; before that as the graph says.
        before_sd_s: of it, s.
    """

    frame: int
    camera: str
    offset_s: float
    sd_s: float
    before_s: float
    before_sd_s: float

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        way = "late" if self.offset_s >= 0 else "early"
        places = 3 if self.sd_s >= 0.002 else 4
        now, sd = f"{abs(self.offset_s):.{places}f}", f"{self.sd_s:.{places}f}"
        before = f"{self.before_s:+.{places}f} ± {self.before_sd_s:.{places}f} s"
        return f"clock of camera {self.camera}: {now} ± {sd} s {way} (before {before})"
