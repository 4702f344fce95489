"""The journal's event of a run that goes on elsewhere."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MachineChanged:
    """The run was resumed on another machine or with other libraries, because that was explicitly allowed.

    From this frame on its numbers may differ in their last digits from those of an unbroken run on either.

    Attributes:
        frame: the first frame that is computed there.
        changes: what differs, each in words: name, before, now.
    """

    frame: int
    changes: tuple[str, ...]
