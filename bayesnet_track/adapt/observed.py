"""What is remembered of the detections that targets were given, one array row a target: pure functions.

A row of T targets with beliefs of D fields has these parts, those that a rule needs:

- the last detection, the frame intervals since then, how many detections there were after the first;
- for the direction (Cao et al. 2023): the detections of the last frames, NaN where there was none, and the
  unit vector from an earlier one to the last;
- for the re-update (same paper): mean and covariance of the belief when the last one had been used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesnet_track.numerics.arrays import Bools, Floats
from bayesnet_track.observation.cue import OBSERVED, AssociationRule, Reference

LAST, GAP, COUNT = slice(0, 4), 4, 5
FIXED = 6


@dataclass(frozen=True)
class Layout:
    """Where the parts of a row stand.

    Attributes:
        frames: L, over how many frames directions are measured; 0 without.
        size: D, of the beliefs that are remembered; 0 without.
    """

    frames: int
    size: int

    @classmethod
    def of(cls, rule: AssociationRule, size: int) -> Layout:
        """That of a rule, for beliefs of D = `size` fields."""
        return cls(rule.direction_frames if rule.direction > 0 else 0, size if rule.re_update else 0)

    @property
    def recent(self) -> slice:
        """Detections of the last L frames, 4 L."""
        return slice(FIXED, FIXED + 4 * self.frames)

    @property
    def heading(self) -> slice:
        """Unit vector of x, y; NaN while unknown."""
        start = FIXED + 4 * self.frames
        return slice(start, start + (2 if self.frames else 0))

    @property
    def mean(self) -> slice:
        """Mean when the last detection had been used."""
        return slice(self.heading.stop, self.heading.stop + self.size)

    @property
    def covariance(self) -> slice:
        """Its covariance, D * D."""
        return slice(self.mean.stop, self.mean.stop + self.size**2)

    @property
    def width(self) -> int:
        """Length of a row."""
        return int(self.covariance.stop)


def first_observed(rule: AssociationRule, boxes: Floats, size: int) -> Floats:
    """(T, H) of targets that start in the centre boxes (T, 4); (T, 0) where nothing is remembered."""
    if not rule.remembers:
        return np.empty((len(boxes), 0))
    layout = Layout.of(rule, size)
    rows = np.full((len(boxes), layout.width), np.nan)
    rows[:, LAST], rows[:, GAP], rows[:, COUNT] = boxes, 0.0, 0.0
    return rows


def remembered(rule: AssociationRule, reference: Reference, mean: Floats) -> Floats:
    """(H,) what a reference holds of this; of a target without detections, the box of its mean (D,)."""
    if OBSERVED in reference:
        return reference[OBSERVED]
    return np.asarray(first_observed(rule, mean[None, :4], len(mean))[0])


def observe(
    rule: AssociationRule,
    observed: Floats,
    before: tuple[Floats, Floats],
    own: Floats,
    is_given: Bools,
    elapsed: float,
) -> Floats:
    """(T, H) after a frame in which targets were given the detections `own` (T, 4), where `is_given`.

    `before` are means (T, D) and covariances (T, D, D) of the beliefs of the frame before, `elapsed` frame
    intervals earlier.
    """
    if not observed.shape[1]:
        return observed
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.compiled import plain
    from bayesnet_track.numerics.kernels.judging_kernels import append_detections, units_of

    heading = np.empty((len(observed), 2))
    layout, after = Layout.of(rule, before[0].shape[1]), observed.copy()
    if layout.size:
        parting = ~is_given & (observed[:, GAP] == 0.0)
        after[parting, layout.mean] = before[0][parting]
        after[parting, layout.covariance] = before[1][parting].reshape(-1, layout.size**2)
    if layout.frames:
        ways = np.where(is_given[:, None], own[:, :2] - earlier(layout, observed)[:, :2], np.nan)
        heading = units_of(ways)
    append_detections(after, plain(own), is_given, FIXED, layout.frames, heading, float(elapsed))
    return after


def earlier(layout: Layout, observed: Floats) -> Floats:
    """(T, 4) the earliest detection within the last L frames, else the last; NaN with the first one only."""
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.compiled import plain
    from bayesnet_track.numerics.kernels.judging_kernels import earlier_rows

    return np.asarray(earlier_rows(plain(observed), COUNT, FIXED, layout.frames))


def direction_consistency(rule: AssociationRule, observed: Floats, boxes: Floats, scores: Floats) -> Floats:
    """(T, N) weight * score * (1/2 - angle / pi): how well the way to a detection goes on from a target's.

    The angle is that between the target's direction and the way from the same earlier detection to each of
    the boxes (N, 4). 0 while a target's direction is not known.
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.compiled import plain
    from bayesnet_track.numerics.kernels.judging_kernels import cosines_of, weigh_angles

    layout = Layout(rule.direction_frames, 0)
    heading, origin = observed[:, layout.heading], earlier(layout, observed)
    angles = np.arccos(cosines_of(plain(heading), origin, plain(boxes)))
    return np.asarray(weigh_angles(angles, rule.direction * scores))
