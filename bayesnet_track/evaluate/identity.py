"""Identity scores (Ristani et al. 2016): how long each target is followed by one track, its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesnet_track.evaluate.clear_mot import LEAST_IOU
from bayesnet_track.evaluate.mot_pairs import Pairs, assign


@dataclass(frozen=True)
class Identity:
    """Counts over a sequence.

    Attributes:
        idtp: true boxes that overlap the box of their target's own track.
        idfn: the other true boxes.
        idfp: the other tracked boxes.
    """

    idtp: int
    idfn: int
    idfp: int

    @property
    def idf1(self) -> float:
        """2 IDTP / (true boxes + tracked boxes)."""
        return 2 * self.idtp / (2 * self.idtp + self.idfn + self.idfp)

    @property
    def idp(self) -> float:
        """IDTP / tracked boxes; 0 when there is none."""
        return self.idtp / max(self.idtp + self.idfp, 1)

    @property
    def idr(self) -> float:
        """IDTP / true boxes."""
        return self.idtp / (self.idtp + self.idfn)


def identity(pairs: Pairs, min_iou: float = LEAST_IOU) -> Identity:
    """Identity scores of a sequence with true boxes.

    Whole tracks are assigned to whole targets, one to one, so that most of their boxes overlap by at least
    `min_iou`. (The published cost, IDFN + IDFP, is the number of all boxes less twice IDTP.)
    """
    together = np.zeros((len(pairs.true_boxes), len(pairs.tracked_boxes)))
    for frame in pairs.frames:
        i, j = np.nonzero(frame.iou >= min_iou)
        together[frame.true[i], frame.tracked[j]] += 1
    idtp = int(together[assign(together)].sum())
    return Identity(idtp, int(pairs.true_boxes.sum()) - idtp, int(pairs.tracked_boxes.sum()) - idtp)
