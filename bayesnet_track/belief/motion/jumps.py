"""Targets that may reappear anywhere in the frame: a component of the motion, and where to search."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesnet_track.belief.contract import Ancestors, MotionModel, hypotheses_of
from bayesnet_track.belief.motion.borders import Confined, Wrapped
from bayesnet_track.belief.motion.modes import Modal
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.belief.particles.particle_set import Inputs
from bayesnet_track.belief.particles.proposals import flatten_to_ess
from bayesnet_track.journal.events.beliefs import Reappeared
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights
from bayesnet_track.numerics.resampling import systematic


@dataclass(frozen=True, eq=False)
class Places:
    """A mixture of uniform densities on rectangles, all inside the frame.

    Attributes:
        low: (M, 2) least x and y.
        high: (M, 2) largest x and y.
        shares: (M,) of the rectangles, summing to 1.
    """

    low: Floats
    high: Floats
    shares: Floats

    def draw(self, size: int, rng: np.random.Generator) -> Floats:
        """(size, 2) points in px, in random order: which hypothesis is sent where depends on nothing."""
        cells = rng.permutation(systematic(self.shares, size, rng))
        return np.asarray(self.low[cells] + rng.random((size, 2)) * (self.high - self.low)[cells])

    def density(self, points: Floats) -> Floats:
        """(N,) per px^2 at points (N, 2)."""
        x, y = points.T[:, :, None]
        is_inside = (
            (x >= self.low[:, 0]) & (x < self.high[:, 0]) & (y >= self.low[:, 1]) & (y < self.high[:, 1])
        )
        extent = (self.high - self.low).T
        return np.asarray(is_inside @ (self.shares / (extent[0] * extent[1])))


@dataclass(frozen=True, eq=False)
class Search:
    """Search for a reappearing target in one frame.

    Attributes:
        hypotheses: share of the hypotheses that look.
        by: uniform, agents, or the detector's name.
        probes: boxes that the net's agents are asked about; 0 for none.
        boxes: (M, 4) where a detector sees something.
        scores: (M,) how surely.
        ud_px2: UD of the last frame.
        above_px2: level above which the belief is unsure.
        fit: what fits without the search, as a share of the usual fit; None when it does not matter.
        below_fit: level below which that calls for the search.
    """

    hypotheses: float
    by: str
    probes: int
    boxes: Floats
    scores: Floats
    ud_px2: float
    above_px2: float
    fit: float | None = None
    below_fit: float | None = None


@dataclass(frozen=True, eq=False)
class Within:
    """The part of the frame in which a target that was lost may reappear by now, as large as it was.

    Attributes:
        low: (2,) least x and y of its centre, px.
        high: (2,) largest x and y.
        size: (2,) w and h of the box that held it last, px.
        half_px: how far from that box.
        cell_box: side of the cells about which agents are asked, in sqrt(w h).
    """

    low: Floats
    high: Floats
    size: Floats
    half_px: float
    cell_box: float = 0.5

    @classmethod
    def around(cls, box: Floats, half_px: float, width: int, height: int, cell_box: float = 0.5) -> Within:
        """The square around the centre box (4,) with half its side in px, as far as the frame goes."""
        half, far_corner = max(half_px, 2.0), np.array([width - 1.0, height - 1.0])
        centre = np.clip(box[:2], 0.0, far_corner)
        return cls(
            np.maximum(centre - half, 0.0), np.minimum(centre + half, far_corner), box[2:4], half, cell_box
        )


FLAT = 100.0
"""Sds of the Gaussian that stands for uniform in a `Transition`, in sides of the frame: flat to 1e-4."""

EVENLY = 0.2
"""Share of the looking hypotheses that are spread evenly: weights are at most its inverse."""

LEAST_PLACES = 8.0
"""Effective places to look at; sharper scores are flattened until there are."""

TELL_ABOVE = 0.5
"""Share of the belief above which it is told that hypotheses which jumped hold it."""


@dataclass(frozen=True, eq=False)
class Jumping(Wrapped):
    """`motion`, or with probability `share` the position is anywhere: (1 - share) p + share / (W H).

    What jumps keeps the motion's size and derivatives. Drift and derivatives are those without jumps. With
    `within` it is anywhere in that part of the frame, and hypotheses that jump start from the size there;
    densities, of places inside it, still take the size to move as without jumps.

    Attributes:
        motion: the model.
        share: probability of a jump, over the frame's own time step.
        width: W, columns of the image; centres lie in [0, W - 1].
        height: H, rows of the image.
        search: how hypotheses that jump are drawn by a belief which weights them.
        within: the part of the frame that it may have reached; None for all of it.
    """

    share: float
    width: int
    height: int
    search: Search
    within: Within | None = None

    @property
    def area(self) -> float:
        """px^2 of where centres lie that jumped."""
        places = self.evenly()
        return float(np.prod(places.high - places.low))

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """Like the model, then each with probability `share` anywhere."""
        propagated = self.motion.propagate(states, dt, rng, parents)
        jumps = np.flatnonzero(rng.random(len(propagated)) < self.share)
        propagated[jumps, :2] = self.evenly().draw(len(jumps), rng)
        return propagated

    def log_density(self, states: Floats, previous: Floats, dt: float) -> Floats:
        """Of the mixture, for states inside the frame."""
        if isinstance(self.motion, Modal):
            return self.motion.each(lambda part: replace(self, motion=part)).log_density(states, previous, dt)
        return self.transition(previous, dt).log_density(states)

    def transition(self, previous: Floats, dt: float) -> Transition:
        """The model's components, and one so wide in x and y that it is flat over the frame.

        Its share is that of its whole, of which the frame holds `share`: inside the frame densities are
        right to 1e-4. It needs x and y, which have noise, as the first two coordinates.
        """
        transition = self.motion.transition(previous, dt)
        flat = transition.sds[:1].copy()
        flat[:, :, :2] = FLAT * np.array([self.width, self.height])
        flat_area = 2.0 * np.pi * FLAT**2 * self.width * self.height / self.area
        shares = [transition.log_shares + np.log1p(-self.share), [np.log(self.share * flat_area)]]
        return Transition(
            transition.coordinates,
            transition.means,
            np.concatenate([transition.sds, flat]),
            np.concatenate(shares),
            transition.states,
        )

    def evenly(self) -> Places:
        """The frame, or the part of it that may have been reached."""
        if self.within is not None:
            return Places(self.within.low[None], self.within.high[None], np.ones(1))
        high = np.array([[self.width - 1.0, self.height - 1.0]])
        return Places(np.zeros((1, 2)), high, np.ones(1))


def jumping_of(motion: MotionModel) -> Jumping | None:
    """The jumping motion inside a confined one, or None."""
    free = motion.motion if isinstance(motion, Confined) else motion
    return free if isinstance(free, Jumping) else None


def modal_of(motion: MotionModel) -> Modal | None:
    """The motion in modes inside a confined one, each mode with the jumps; None for one without."""
    free = motion.motion if isinstance(motion, Confined) else motion
    if isinstance(free, Jumping) and isinstance(free.motion, Modal):
        jumping = free
        return free.motion.each(lambda part: replace(jumping, motion=part))
    return free if isinstance(free, Modal) else None


@dataclass(frozen=True, eq=False)
class Jumps:
    """Hypotheses of a frame, some of which jumped.

    Attributes:
        states: (N, D).
        prior_log: (N,) log-weights that make them a sample of the prior.
        which: indices of those that jumped.
    """

    states: Floats
    prior_log: Floats
    which: Ancestors


def draw_jumps(inputs: Inputs, jumping: Jumping, ancestors: Ancestors, beta_log: Floats) -> Jumps:
    """Hypotheses from both components, each with as many as `search` says, weighted to be a sample of both.

    A hypothesis of the motion has the weight beta (1 - share) N / n, one that jumped beta share N / m times
    the uniform density over the one it was drawn with. Their numbers n + m = N are fixed, and which jump is
    drawn whatever they are: the evidence is unbiased.
    """
    size = len(ancestors)
    count = min(max(round(jumping.search.hypotheses * size), 1), size - 1)
    rng = inputs.stream("jump")
    jumped = np.sort(rng.permutation(size)[:count]).astype(np.intp, copy=False)
    motion = Confined(jumping.motion, jumping.width, jumping.height)
    states = motion.propagate(inputs.prior.states, inputs.dt, inputs.stream("propagate"), ancestors)
    places = _places(inputs, jumping, states, rng)
    states[jumped, :2] = places.draw(count, rng)
    if jumping.within is not None:
        states[jumped, 2:4] *= jumping.within.size / inputs.prior.states[ancestors[jumped], 2:4]
    prior_log = beta_log + np.log((1.0 - jumping.share) * size / (size - count))
    prior_log[jumped] = beta_log[jumped] + np.log(
        jumping.share * size / count / (jumping.area * places.density(states[jumped, :2]))
    )
    return Jumps(states, prior_log, jumped)


def report_reappeared(
    jumping: Jumping, jumps: Jumps, weights: LogWeights, previous: Floats
) -> Reappeared | None:
    """Event where hypotheses that jumped hold more than half of the belief; frame and target left open."""
    jumped_weights = weights.weights[jumps.which]
    mass = float(jumped_weights.sum())
    if not mass > TELL_ABOVE:
        return None
    x, y = (jumped_weights / mass @ jumps.states[jumps.which, :2]).tolist()
    odds = jumping.share / (1.0 - jumping.share) * max(1.0 - mass, 1e-300) / mass
    search = jumping.search
    return Reappeared(
        frame=0,
        target="",
        by=search.by,
        hypotheses=len(jumps.which),
        held=mass,
        level=TELL_ABOVE,
        share=jumping.share,
        turning=odds / (1.0 + odds),
        x=x,
        y=y,
        moved_px=float(np.hypot(x - previous[0], y - previous[1])),
        ud_px2=search.ud_px2,
        above_px2=search.above_px2,
        within_px=None if jumping.within is None else jumping.within.half_px,
        fit=search.fit,
        below_fit=search.below_fit,
    )


def _places(inputs: Inputs, jumping: Jumping, states: Floats, rng: np.random.Generator) -> Places:
    """Places to look: mostly where the search finds something, else evenly."""
    search = jumping.search
    if search.probes:
        places = _probe(inputs, jumping, states, rng)
    else:
        places = _of_boxes(jumping, search.boxes, search.scores)
    evenly = jumping.evenly()
    if places is None:
        return evenly
    return Places(
        np.concatenate([places.low, evenly.low]),
        np.concatenate([places.high, evenly.high]),
        np.append((1.0 - EVENLY) * places.shares, EVENLY),
    )


def _of_boxes(jumping: Jumping, boxes: Floats, scores: Floats) -> Places | None:
    """Inside the boxes (M, 4), as far as they lie in the frame, in proportion to their scores (M,)."""
    frame = jumping.evenly()
    low = np.clip(boxes[:, :2] - boxes[:, 2:] / 2, frame.low, frame.high)
    high = np.clip(boxes[:, :2] + boxes[:, 2:] / 2, frame.low, frame.high)
    keep = (high - low >= 1.0).all(axis=1) & (scores > 0)
    if not keep.any():
        return None
    return Places(low[keep], high[keep], scores[keep] / scores[keep].sum())


def _probe(inputs: Inputs, jumping: Jumping, states: Floats, rng: np.random.Generator) -> Places | None:
    """Cells of a lattice over the frame, by what the net says of a box in each; None when it says nothing.

    The boxes are no hypotheses, so no evidence is used twice. Where a part of the frame is searched, cells
    stay small, and if there are too many, a strip of them is asked about, another one in each frame.
    """
    start, bounds = jumping.evenly().low[0], jumping.evenly().high[0] - jumping.evenly().low[0]
    limit, window = jumping.search.probes, jumping.within
    if window is None:
        side = 0.5 * float(np.sqrt(np.mean(states[:, 2] * states[:, 3])))
        side = max(side, float(np.sqrt(jumping.area / limit)))
    else:
        side = max(window.cell_box * float(np.sqrt(np.prod(window.size))), 1.0)
    columns, rows = (max(int(extent / side), 1) for extent in bounds)
    step = bounds / np.array([columns, rows])
    cells = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=2).reshape(-1, 2)
    if window is not None and len(cells) > limit:
        cells = np.roll(cells, -int(rng.integers(len(cells))), axis=0)[:limit]
    low = start + cells * step
    probes = states[rng.integers(len(states), size=len(cells))].copy()
    probes[:, :2] = low + step / 2
    if window is not None:
        probes[:, 2:4] = window.size
    if isinstance(jumping.motion, Modal):
        probes[:, -1] = jumping.motion.modes.hidden.index(False)
    equal = LogWeights.uniform(len(cells))
    evidence = inputs.evaluate(hypotheses_of(probes, inputs.prior.fields), equal.log)
    try:
        weights = flatten_to_ess(equal, evidence.log_likelihood, min(LEAST_PLACES, len(cells) / 2))[1]
    except DegenerateWeights:
        return None
    return Places(low, low + step, weights.weights)
