"""A target of which nothing is seen any more: what is found later has to fit as the target did before."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import median

from bayesnet_track.engine.scoring.score import LEAST_LOG, Scored
from bayesnet_track.graph.settings.adapt import Lost
from bayesnet_track.journal.events.statuses import FoundAgain
from bayesnet_track.numerics.records import changed

USUAL_FRAMES = 10
"""Frames on target whose median fit counts as usual."""

LEAST_FRAMES = 5
"""Frames without which nothing is usual yet."""

SAYS_NOTHING = 0.1
"""Nats by which a frame moves the belief, below which all hypotheses fit alike, as in a black frame."""

FAR_BOX = 4.0
"""Box sides from which on distance asks for no more of the fit, nor one side farther of the score: there the
fifth roots of the levels count."""


@dataclass(frozen=True)
class Look:
    """What a frame shows of a target.

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


def usual_fit(scored: Scored) -> float | None:
    """How well the target usually fits; None while nothing is usual yet, or it is missing."""
    if scored.missing is not None or len(scored.fits) < LEAST_FRAMES:
        return None
    return math.exp(median(scored.fits))


def follow_fit(scored: Scored, rule: Lost, look: Look) -> tuple[Scored, float, FoundAgain | None]:
    """What is remembered after a frame, the most that its score may be, and how a target was found again.

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
            return changed(scored, low=0), 1.0, None
        if look.score >= rule.score_below:
            if look.score < (rule.uncertain_below or rule.score_below):
                return changed(scored, low=0), 1.0, None
            held = (*scored.fits, log_fit)[-USUAL_FRAMES:]
            return changed(scored, low=0, fits=held, place=(look.x, look.y)), 1.0, None
        low = scored.low + 1
        is_lost = low >= rule.frames and len(scored.fits) >= LEAST_FRAMES
        return changed(scored, low=low, missing=look.frame - low + 1 if is_lost else None), 1.0, None
    share = math.exp(log_fit - median(scored.fits))
    moved_px = math.hypot(look.x - scored.place[0], look.y - scored.place[1])
    away = moved_px / look.side_px
    strict = 1.0 / (1.0 + min(away, FAR_BOX))
    level = rule.found_fit**strict
    if share < level:
        return changed(scored, again=()), 0.5 * (share / level) ** min(away, 1.0), None
    again = (*scored.again, min(share, 1.0) ** (1.0 / strict))
    if len(again) < rule.frames:
        return changed(scored, again=again), 1.0, None
    # Where the target was badly held its usual fit is poor, and a look-alike reaches it, but no high score.
    beyond = min(max(away - 1.0, 0.0), FAR_BOX)
    score_level = (rule.uncertain_below or rule.score_below) ** (1.0 / (1.0 + beyond))
    if look.score < score_level:
        return changed(scored, again=again[1:]), 0.5, None
    found = FoundAgain(
        look.frame,
        look.target,
        share,
        level,
        rule.found_fit,
        rule.frames,
        min(again),
        scored.missing,
        moved_px,
        look.score,
        score_level,
    )
    return changed(scored, missing=None, again=(), low=0), 1.0, found
