"""The estimate of a target or part as a box, in each of the three conventions by its name."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

GONE = (
    "{kind} has no `box`, since the name did not say which convention: use .xywh (left, top, width, height), "
    ".xyxy (corners) or .cxcywh (centre, width, height)"
)
"""What to use in place of the attribute that was there."""


class Boxed:
    """What holds a box, as float64 arrays (4,) in px. Centres of pixels lie at integers.

    The class has `centre_box`, the numbers centre x, y, width, height: `box` in the files of a run.
    """

    if TYPE_CHECKING:  # a field or property of the class that is one

        @property
        def centre_box(self) -> tuple[float, ...]:
            """Centre x, y, width, height in px."""

    @property
    def xywh(self) -> NDArray[np.float64]:
        """Left, top, width, height, as OpenCV and files of tracks have it."""
        from bayesnet_track.numerics.boxes import corner_from_centre

        return corner_from_centre(self.centre_box)

    @property
    def xyxy(self) -> NDArray[np.float64]:
        """Left, top, left + width, top + height, as supervision has it."""
        from bayesnet_track.numerics.boxes import xyxy_from_centre

        return xyxy_from_centre(self.centre_box)

    @property
    def cxcywh(self) -> NDArray[np.float64]:
        """Centre x and y, width, height, as the journal and the engine have it."""
        import numpy as np

        return np.array(self.centre_box, dtype=np.float64)

    if not TYPE_CHECKING:  # for type checkers it does not exist

        @property
        def box(self):
            """Not there any more; raises AttributeError, which says what to use."""
            raise AttributeError(GONE.format(kind=type(self).__name__))

    def _xywh_text(self) -> str:
        return ",".join(f"{value:.1f}" for value in self.xywh)
