"""The states of what is detected, and how probable each is: a forward filter in columns.

A target that exists is in one of three states: open, blind (nothing covers it, and yet the detector cannot
see it), hidden (another target covers it). Beside targets there are false alarms that last: a spot of the
background, or a double, a second box on a target. With the probabilities of the states p_s, of a detection in
each d_s, and the probability q that it was detected (`adapt.existence.share`),

    p_s' = q p_s d_s / sum_k p_k d_k + (1 - q) p_s (1 - d_s) / (1 - sum_k p_k d_k),

which is the posterior of a hidden Markov model whose states are these and "absent". Between looks a blind
target stays so for `missed_frames` on average, a false alarm lasts for `false_frames`, and a double ends
where it leaves its target. Who of two that overlap is hidden is not known at first: the share of covered
targets that are hidden follows from how often covered targets are detected, each miss makes it more probable,
and each detection less. Blind and hidden are states of one target and one detector: each has its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.records import evolve

UNSEEN = 0.05
"""Probability that a target is detected which is blind or hidden."""


LASTS = 0.9
"""How much of what is known of a covered target is still true one frame later."""


def _none() -> Floats:
    return np.empty(0)


@dataclass(frozen=True, eq=False)
class Presence:
    """Beliefs about T targets or unconfirmed tracks beside the probability that each exists.

    Attributes:
        blind: (T,) probability that it is blind, given that it is a target.
        hidden: (T,) that another target hides it, given that it is a target.
        spot: (T,) probability that it is a false alarm of the background.
        double: (T,) that it is a second box on a target.
        open_seen: (T,) probability that it was detected in the last look while nothing covered it.
        seen: (T,) expected number of its detections.
        begun: (T,) probability that its first detection was no target's.
        near: (T,) that a target covered that.
    """

    blind: Floats = field(default_factory=_none)
    hidden: Floats = field(default_factory=_none)
    spot: Floats = field(default_factory=_none)
    double: Floats = field(default_factory=_none)
    open_seen: Floats = field(default_factory=_none)
    seen: Floats = field(default_factory=_none)
    begun: Floats = field(default_factory=_none)
    near: Floats = field(default_factory=_none)

    def __len__(self) -> int:
        return len(self.blind)

    @property
    def false(self) -> Floats:
        """(T,) probability that it is a false alarm that lasts."""
        return self.spot + self.double

    @classmethod
    def sure(cls, count: int) -> Presence:
        """Targets that were just detected, and certainly are targets."""
        nothing, once = np.zeros(count), np.ones(count)
        return cls(nothing, nothing, nothing, nothing, once, once, nothing, nothing)

    def take(self, rows: np.ndarray | Ints | slice) -> Presence:
        """Some of them."""
        return Presence(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def extend(self, added: Presence) -> Presence:
        """These, then others."""
        names = self.__dataclass_fields__
        return Presence(*(np.concatenate([getattr(self, n), getattr(added, n)]) for n in names))


@dataclass(frozen=True, eq=False)
class Known:
    """The presence of targets by their names.

    Attributes:
        names: of the targets.
        presence: of each.
    """

    names: tuple[str, ...] = ()
    presence: Presence = field(default_factory=Presence)

    def of(self, names: Sequence[str]) -> Presence:
        """The presence of targets; of those that are not known, that of sure ones."""
        if tuple(names) == self.names:
            return self.presence
        rows = {name: row for row, name in enumerate(self.names)}
        extended = self.presence.extend(Presence.sure(1))
        return extended.take(np.array([rows.get(name, len(self.names)) for name in names], dtype=np.int64))


@dataclass(frozen=True)
class PresenceChain:
    """Transitions between the states of a target, a frame interval apart.

    Attributes:
        detection: probability that an open target is detected.
        enter: that one becomes blind.
        leave: that a blind one becomes open.
        false_ends: that a false alarm ends.
    """

    detection: float
    enter: float
    leave: float
    false_ends: float

    @property
    def blind_share(self) -> float:
        """Share of its time in the open in which a target is blind."""
        return self.enter / (self.enter + self.leave) if self.enter else 0.0


def pass_time(presence: Presence, chain: PresenceChain, dt: float) -> Presence:
    """The presence as it is expected after `dt` frame intervals in which nobody looked."""
    persistence = max(1.0 - chain.enter - chain.leave, 0.0) ** dt
    lasts = (1.0 - chain.false_ends) ** dt
    free = 1.0 - presence.hidden
    blind = chain.blind_share * free + (presence.blind - chain.blind_share * free) * persistence
    return evolve(presence, blind=blind, spot=lasts * presence.spot, double=lasts * presence.double)


def expect_cover(presence: Presence, cover: Floats, share: float) -> Presence:
    """The presence of targets that others cover with probability `cover` (T,), `share` of whom are hidden.

    A hidden target becomes open as it leaves the other; a double ends there.
    """
    hidden, blind = presence.hidden, presence.blind
    enter = cover * share * (1.0 - LASTS * cover)
    stay = cover * (share + (1.0 - share) * LASTS * cover)
    expected = (1.0 - hidden - blind) * enter + hidden * stay
    return evolve(presence, hidden=expected, double=presence.double * cover)


@dataclass(frozen=True, eq=False)
class Weights:
    """Probabilities of the states of T targets or tracks, (T,) each, and of a detection in each state.

    Attributes:
        states: (T, 5) open, blind, hidden, spot, double.
        detection: (T, 5).
        presence: what is known of each.
    """

    states: Floats
    detection: Floats
    presence: Presence

    @classmethod
    def of(
        cls, existence: Floats, presence: Presence, chain: PresenceChain, visible: Floats | float = 1.0
    ) -> Weights:
        """Weights of targets that exist with `existence` (T,) and can be seen with probability `visible`."""
        unseen = np.minimum(UNSEEN, chain.detection) * np.ones(len(existence))
        detected = chain.detection * np.ones(len(existence))
        opened = np.maximum(1.0 - presence.blind - presence.hidden, 0.0)
        targets = (existence * part for part in (opened, presence.blind, presence.hidden))
        states = np.column_stack([*targets, presence.spot, presence.double])
        detection = np.column_stack(
            [detected * visible, unseen * visible, unseen * visible, detected, detected]
        )
        return cls(states, detection, presence)

    @property
    def total(self) -> Floats:
        """(T,) probability that there is anything."""
        return np.asarray(np.minimum(self.states.sum(axis=1), 1.0))

    @property
    def mean_detection(self) -> Floats:
        """(T,) probability that it is detected if there is anything."""
        hit = (self.states * self.detection).sum(axis=1)
        return np.asarray(hit / np.maximum(self.states.sum(axis=1), 1e-300))

    def after(self, detected: Floats) -> tuple[Floats, Presence]:
        """Existence (T,) and presence after a look; `detected` (T,): probability that each was detected.

        >>> states, detection = np.array([[0.5, 0.2, 0, 0.1, 0]]), np.array([[0.9, 0.05, 0.05, 0.9, 0.9]])
        >>> weights = Weights(states, detection, Presence.sure(1))
        >>> existence, presence = weights.after(np.array([0.0]))
        >>> float(existence[0].round(4)), float(presence.spot[0].round(4))  # .05 + .19 and .01 of .45
        (0.5333, 0.0222)
        """
        hits, misses = self.states * self.detection, self.states * (1.0 - self.detection)
        hit = hits.sum(axis=1)
        if_seen = hits / np.maximum(hit, 1e-300)[:, None]
        if_missed = misses / np.maximum(1.0 - hit, 1e-300)[:, None]
        posterior = detected[:, None] * if_seen + (1.0 - detected)[:, None] * if_missed
        existence = posterior[:, :3].sum(axis=1)
        blind, hidden = posterior[:, 1:3].T / np.maximum(existence, 1e-300)
        states = {"blind": blind, "hidden": hidden, "spot": posterior[:, 3], "double": posterior[:, 4]}
        return np.minimum(existence, 1.0), evolve(self.presence, **states, seen=self.presence.seen + detected)


SHIFT = 1.0 / 3.0
"""Boxes of one size that are shifted by this share of a side overlap by a half (IoU)."""
