"""Score features of a target: how sure it is that it is held, how it met its like, and when it is back."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median
from types import MappingProxyType

import numpy as np

from bayesnet_track.adapt.rule_inputs import Measures
from bayesnet_track.belief.contract import Evidence, Posterior, Step
from bayesnet_track.graph.settings.adapt import Lost
from bayesnet_track.graph.settings.scores import confidence_feature
from bayesnet_track.graph.spec import Localization, Logistic
from bayesnet_track.journal.events.statuses import FoundAgain
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.density import mixture_quantiles
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import Reference
from bayesnet_track.observation.planes import Frame

SUREST = 0.999
"""More confidence than this, or less than 1 minus this, says no more."""


def confidences(rule: Logistic, evidence: Evidence) -> dict[str, float]:
    """Feature of the score -> log odds of the confidence of an agent; only of those that ran in the frame.

    An agent that saw nothing has none.
    """
    measured = {agent: evidence.measured[agent] for agent in rule.confidence if agent in evidence.measured}
    values = {agent: 0.0 if reading is None else reading.confidence for agent, reading in measured.items()}
    return {
        confidence_feature(agent): log_odds(value) for agent, value in values.items() if value is not None
    }


def log_odds(confidence: float) -> float:
    """log(p / (1 - p)) of a confidence 0..1, which counts as at most `SUREST`.

    >>> round(log_odds(0.9), 3), round(log_odds(1.0), 3), round(log_odds(0.0), 3)
    (2.197, 6.907, -6.907)
    """
    p = min(max(confidence, 1.0 - SUREST), SUREST)
    return math.log(p / (1.0 - p))


SPAN = 5
"""Estimates from which the target's motion is taken."""

BEFORE = 5
"""Estimates before a look-alike is noticed that do not count: the wrong one may be followed already."""

WAIT = 2
"""Frames without a look-alike after which motion may show it."""

LASTS = 50
"""Frames after the look-alike was seen for which either is taken to move on in a straight line."""

APART_BOX = 1.0
"""Box sides that the two have to be apart by then."""

NEAR_BOX = 2.0
"""Box sides from the target's place within which the estimate has to be: farther off it is neither's."""

NEARER = 0.5
"""The estimate has to be nearer to the target's place than this share of its distance to the other's."""


@dataclass(frozen=True)
class Place:
    """The centre of something in a frame, px."""

    frame: int
    x: float
    y: float

    def distance(self, place: Place) -> float:
        """Distance of the centres, px."""
        return math.hypot(self.x - place.x, self.y - place.y)


@dataclass(frozen=True)
class Encounter:
    """Encounter of a target with something that looks like it: how both moved.

    Attributes:
        own: two places of the target before; None where there are no two.
        first: the look-alike's when it was seen first, and `last` when it was seen last.
        behind_nats: by how much it was less likely than the target, at most.
    """

    own: tuple[Place, Place] | None
    first: Place
    last: Place
    behind_nats: float


def place_in(frame: int, first: Place, second: Place) -> Place:
    """Place of something in a frame if it moves on as between two places.

    >>> place_in(4, Place(1, 0.0, 5.0), Place(2, 3.0, 5.0))
    Place(frame=4, x=9.0, y=5.0)
    """
    steps = (frame - second.frame) / (second.frame - first.frame)
    return Place(frame, second.x + steps * (second.x - first.x), second.y + steps * (second.y - first.y))


def motion_before(places: Sequence[Place]) -> tuple[Place, Place] | None:
    """Two places that show how the target moved before a look-alike was noticed; None with fewer places."""
    considered = places[:-BEFORE][-SPAN:]
    considered = considered if len(considered) > 1 else places[:2]
    return (considered[0], considered[-1]) if len(considered) > 1 else None


def distances_since(met: Encounter, place: Place, side_px: float) -> tuple[float, float] | None:
    """Distances of an estimate from where the target and the other one should be by now, in box sides.

    None where motion does not show it: the other was seen in one frame only or long ago, or both should be at
    nearly the same place.
    """
    if met.own is None or met.first.frame == met.last.frame or place.frame - met.last.frame > LASTS:
        return None
    own_place, other_place = place_in(place.frame, *met.own), place_in(place.frame, met.first, met.last)
    if own_place.distance(other_place) <= APART_BOX * side_px:
        return None
    return place.distance(own_place) / side_px, place.distance(other_place) / side_px


Region = tuple[float, float, float, float]

USUAL_FRAMES = 20
"""Frames of an agent whose median log evidence counts as usual."""

LEAST_LOG = -20.0
"""Logarithms below it say nothing more: a feature is at least this."""

OF_THE_BOX = ("log_size", "border")
"""Features of the estimate alone, not of what fits it."""

BEYOND = 0.1
"""Share of a side of the box: farther beyond the image says no more."""

MARGINAL_POINTS = 32
"""Quantiles that stand for the posterior of each coordinate where it is widened; even."""


@dataclass(frozen=True)
class Agreement:
    """Agreement on one place, at last at `x`, `y` px, in so many `frames` in a row.

    All of them would count up to a level `score_above`, and down to a level `ud_box`.
    """

    x: float
    y: float
    frames: int
    score_above: float
    ud_box: float


@dataclass(frozen=True)
class ScoreState:
    """Memory of the score of a target.

    Attributes:
        smooth: feature -> its filtered value, of those that had one; empty before the first frame.
        usual: agent -> its log evidence in its first frames.
        side_px: sqrt(w h) of the first estimate.
        distractors: consecutive frames with a distractor, up to the last one in which all agents looked.
        doubt: frames for which the score is at most one half, since a distractor was seen.
        places: the last estimates of a target that is seen; empty without a rule for distractors.
        meeting: how the target and the distractor of the last such frames moved; None before any.
        encounter: the same of the distractor that put the target in doubt.
        recent: the last scores, as many as the guarantee asks for; none without one.
        cusum: what the alarm's evidence has risen to, nats; 0 without an alarm.
        since: first frame of this rise; None while there is none.
        alarmed: whether the alarm was raised since then.
        fits: log fits of its last frames while it was held.
        low: consecutive frames in which something is seen, but nothing that is the target.
        missing: frame since which nothing is seen that fits as the target did; None while something is.
        again: largest `found_fit` at which each of the last consecutive frames that show it would still do.
        place: x and y of the last estimate while it was held, px; empty before there is one.
        agreement: agreement on one place while it is not tracked; None without any.
        references: verifier -> what it remembers; empty of one that failed.
        unfit: whether nothing fitted in the last frame, so that the score was bounded by `full_fit`.
    """

    smooth: Mapping[str, float] = field(default_factory=dict)
    usual: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    side_px: float | None = None
    distractors: int = 0
    doubt: int = 0
    places: tuple[Place, ...] = ()
    meeting: Encounter | None = None
    encounter: Encounter | None = None
    recent: tuple[float, ...] = ()
    cusum: float = 0.0
    since: int | None = None
    alarmed: bool = False
    fits: tuple[float, ...] = ()
    low: int = 0
    missing: int | None = None
    again: tuple[float, ...] = ()
    place: tuple[float, ...] = ()
    agreement: Agreement | None = None
    references: Mapping[str, Reference] = field(default_factory=dict)
    unfit: bool = False

    def after(
        self,
        rule: Logistic,
        measures: Measures,
        step: Step[Posterior],
        ud_px2: float | None,
        features: Mapping[str, float] = MappingProxyType({}),
    ) -> ScoreState:
        """With one frame more; `ud_px2` is the root's UD, `features` the features that the caller computes.

        Those of verifiers and agents that say nothing keep their values, and so does `log_ud_box` without a
        UD: a belief is as wide as the search that made it, or has nothing to go by where nothing fits.
        """
        seeing = [agent for agent in measures.kl if agent not in measures.silent]
        log_evidence = {agent: _log_evidence(step, agent) for agent in seeing}
        usual_evidence = dict(self.usual)
        for agent, value in log_evidence.items():
            if len(usual_evidence.get(agent, ())) < USUAL_FRAMES:
                usual_evidence[agent] = (*usual_evidence.get(agent, ()), value)
        side = math.sqrt(max(measures.area_px2, 1.0))
        first = side if self.side_px is None else self.side_px
        values = {
            **({} if ud_px2 is None else {"log_ud_box": _log(ud_px2 / side**2)}),
            "evidence": _mean([log_evidence[agent] - median(usual_evidence[agent]) for agent in seeing]),
            # Below `full_fit` the bound says at once what the frame is worth: its memory needs no more.
            "log_fit": _log(max(measures.fit, rule.full_fit)),
            "agreement": _agreement(step, seeing),
            "log_size": abs(math.log(side / first)),
            **{name: max(value, LEAST_LOG) for name, value in features.items()},
        }
        unfit = measures.fit < rule.full_fit
        # What the evidence was while nothing fitted, as in a black frame, is forgotten when something does.
        forgets = unfit or self.unfit
        previous = {name: self.smooth.get(name, value) for name, value in values.items()}
        previous |= {name: value for name, value in values.items() if forgets and name not in OF_THE_BOX}
        gain = 1.0 - math.exp(-1.0 / rule.memory_frames) if rule.memory_frames else 1.0
        smooth = {
            name: value if gain == 1.0 else previous[name] + gain * (value - previous[name])
            for name, value in values.items()
        }
        merged = {**self.smooth, **smooth}
        smooth = {name: merged[name] for name in rule.coefficients if name in merged}
        doubt = max(self.doubt - 1, 0)
        return evolve(self, smooth=smooth, usual=usual_evidence, side_px=first, doubt=doubt, unfit=unfit)

    def features(self, rule: Logistic) -> dict[str, float]:
        """Feature -> its filtered value; 0 of one that has had none."""
        return {name: self.smooth.get(name, 0.0) for name in rule.coefficients}


def extent_beyond(box: Floats, frame: Frame) -> float:
    """Extent to which a centre box (4,) lies beyond the image: 0 inside, 1 from `BEYOND` of its side on.

    A target at the edge of the image is not one that leaves, and its box is not exact.
    """
    x, y, w, h = box.tolist()
    beyond_x: float = max(w / 2 - x - 0.5, x + w / 2 + 0.5 - frame.width) / w
    beyond_y: float = max(h / 2 - y - 0.5, y + h / 2 + 0.5 - frame.height) / h
    return min(max(beyond_x / BEYOND, beyond_y / BEYOND, 0.0), 1.0)


def probability(rule: Logistic, features: Mapping[str, float]) -> float:
    """1 / (1 + exp(-(bias + sum of coefficient times feature))).

    >>> rule = Logistic(bias=1.0, log_ud_box=-0.5)
    >>> probability(rule, dict.fromkeys(rule.coefficients, 2.0))
    0.5
    """
    odds = rule.bias + sum(slope * features[name] for name, slope in rule.coefficients.items())
    return 1.0 / (1.0 + math.exp(-odds)) if odds > -700.0 else 0.0


def most(rule: Logistic, fit: float, doubt: int) -> float:
    """The largest score of a frame: no more than what fits in it, and no more than one half while in doubt.

    >>> most(Logistic(bias=0.0, full_fit=0.25), fit=0.125, doubt=0)
    0.5
    """
    bound = min(fit / rule.full_fit, 1.0) if rule.full_fit > 0.0 else 1.0
    return min(bound, 0.5) if doubt else bound


@dataclass(frozen=True)
class BlurredRegions:
    """Bounds of the centre x_low, x_high, y_low, y_high, px, and the localization error's variance, px^2."""

    region50: Region
    region90: Region
    variance: float


def blur_regions(posterior: Posterior, rule: Localization, score: float, side_px: float) -> BlurredRegions:
    """The posterior's regions, its centre blurred by the localization error.

    p(c) = sum_h w_h [p N(c; h, sd_box^2 s^2 I) + (1 - p) N(c; h, lost_sd_box^2 s^2 I)], p = `score` and
    s = `side_px`: a mixture of being on target and off it. Without `lost_sd_box`, p = 1. With a heavy tail,
    the first sd is `factor` times as large in the share `weight`.
    """
    sd = max(rule.sd_box * side_px, 1e-6)
    lost_sd = sd if rule.lost_sd_box is None else rule.lost_sd_box * side_px
    p = 1.0 if rule.lost_sd_box is None else score
    tail, factor = (0.0, 1.0) if rule.heavy_tail is None else (rule.heavy_tail.weight, rule.heavy_tail.factor)
    sds, shares = (sd, factor * sd, lost_sd), (p * (1.0 - tail), p * tail, 1.0 - p)
    levels = (0.05, 0.25, 0.75, 0.95)
    (x5, x25, x75, x95), (y5, y25, y75, y95) = mixture_quantiles(
        marginal_points(posterior), sds, shares, levels
    ).tolist()
    variance = sum(share * s**2 for share, s in zip(shares, sds, strict=True))
    return BlurredRegions((x25, x75, y25, y75), (x5, x95, y5, y95), variance)


def marginal_points(posterior: Posterior) -> Floats:
    """(2, 32) equally probable x and y of the centre, px: the quantiles (i + 1/2) / 32 of each."""
    shares = [1.0 - (2 * i + 1) / MARGINAL_POINTS for i in range(MARGINAL_POINTS // 2)]
    bounds = posterior.regions(shares)
    return np.concatenate([bounds[:, 0::2], bounds[::-1, 1::2]]).T


def _log_evidence(step: Step[Posterior], agent: str) -> float:
    """log of the sum of beta L over the hypotheses, beta their prior weights."""
    log = step.prior.log + step.evidence.messages[agent]
    top = float(log.max())
    return max(top + math.log(float(np.exp(log - top).sum())), LEAST_LOG) if top > LEAST_LOG else LEAST_LOG


def _agreement(step: Step[Posterior], agents: list[str]) -> float:
    peak = int(step.support.weights.log.argmax())
    messages = [step.evidence.messages[agent] for agent in agents]
    return _mean([max(float(message[peak]) - float(message.max()), LEAST_LOG) for message in messages])


def _mean(values: list[float]) -> float:
    """The mean; without any agent that saw something, the least there is."""
    return sum(values) / len(values) if values else LEAST_LOG


def _log(value: float) -> float:
    return max(math.log(value), LEAST_LOG) if value > 0 else LEAST_LOG


FIT_FRAMES = 10
"""Frames on target whose median fit counts as usual."""

LEAST_FRAMES = 5
"""Frames without which nothing is usual yet."""

SAYS_NOTHING = 0.1
"""Nats by which a frame moves the belief, below which all hypotheses fit alike, as in a black frame."""

FAR_BOX = 4.0
"""Box sides from which on distance asks for no more of the fit, nor one side farther of the score: there the
fifth roots of the levels count."""


@dataclass(frozen=True)
class Sighting:
    """Appearance of a target in one frame.

    Attributes:
        frame: the frame.
        target: target id.
        status: the target's before the frame.
        score: what it is worth by itself.
        fit: likelihood of the best hypothesis, geometric mean over the agents.
        surprise: how far the frame moved the belief, nats.
        x: of the estimate, px; likewise `y`.
        side_px: root of its area.
    """

    frame: int
    target: str
    status: str
    score: float
    fit: float
    surprise: float
    x: float
    y: float
    side_px: float


def usual_fit(scored: ScoreState) -> float | None:
    """Usual fit of the target; None while nothing is usual yet, or it is missing."""
    if scored.missing is not None or len(scored.fits) < LEAST_FRAMES:
        return None
    return math.exp(median(scored.fits))


def follow_fit(scored: ScoreState, rule: Lost, look: Sighting) -> tuple[ScoreState, float, FoundAgain | None]:
    """Memory after a frame, the most that its score may be, and how a target was found again.

    A target is missing after `frames` frames with a score below `score_below`, those left out in which
    nothing is seen at all. It is found when something fits at least `found_fit` of what was usual for
    `frames` frames in a row, and the score of the last is that of a tracked target: `uncertain_below`. More
    is asked for away from where the target was held, of the score from one box side on. What fits less well,
    something beside it or what hides it, keeps the score at one half or below.
    """
    assert rule.found_fit is not None and rule.score_below is not None
    log_fit = max(math.log(look.fit), LEAST_LOG) if look.fit > 0.0 else LEAST_LOG
    if scored.missing is None:
        if look.surprise < SAYS_NOTHING:
            return evolve(scored, low=0), 1.0, None
        if look.score >= rule.score_below:
            if look.score < (rule.uncertain_below or rule.score_below):
                return evolve(scored, low=0), 1.0, None
            usual_fits = (*scored.fits, log_fit)[-FIT_FRAMES:]
            return evolve(scored, low=0, fits=usual_fits, place=(look.x, look.y)), 1.0, None
        low = scored.low + 1
        is_lost = low >= rule.frames and len(scored.fits) >= LEAST_FRAMES
        return evolve(scored, low=low, missing=look.frame - low + 1 if is_lost else None), 1.0, None
    share = math.exp(log_fit - median(scored.fits))
    moved_px = math.hypot(look.x - scored.place[0], look.y - scored.place[1])
    distance_box = moved_px / look.side_px
    strict = 1.0 / (1.0 + min(distance_box, FAR_BOX))
    level = rule.found_fit**strict
    if share < level:
        return evolve(scored, again=()), 0.5 * (share / level) ** min(distance_box, 1.0), None
    fits_again = (*scored.again, min(share, 1.0) ** (1.0 / strict))
    if len(fits_again) < rule.frames:
        return evolve(scored, again=fits_again), 1.0, None
    # Where the target was badly held its usual fit is poor, and a look-alike reaches it, but no high score.
    beyond = min(max(distance_box - 1.0, 0.0), FAR_BOX)
    score_level = (rule.uncertain_below or rule.score_below) ** (1.0 / (1.0 + beyond))
    if look.score < score_level:
        return evolve(scored, again=fits_again[1:]), 0.5, None
    event = FoundAgain(
        look.frame,
        look.target,
        share,
        level,
        rule.found_fit,
        rule.frames,
        min(fits_again),
        scored.missing,
        moved_px,
        look.score,
        score_level,
    )
    return evolve(scored, missing=None, again=(), low=0), 1.0, event
