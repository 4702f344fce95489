"""Choose when agents are switched on and off by what it costs and how well the target is held."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from bayesnet_track.graph.spec import Adapt

SCALES = (1.0, 1.5, 3.0)
"""Factors on both levels: the higher they are, the less often agents work."""

SPARED = 0.01
"""Success AUC that a cheaper policy may lose on other videos, mean over them."""

CONFIDENCE = 1.645
"""Standard errors that are added to a mean loss: the one-sided 95 % bound of a Gaussian."""

FIRST_VIDEOS = 12
"""Videos on which every candidate is tried; each later round doubles them.

A policy changes the AUC of a single video by some 0.03 either way: on fewer, a loss of 0.01 is not seen.
"""


@dataclass(frozen=True)
class Policy:
    """Levels of UD in the graph's own units, and how often an agent that is off still looks."""

    activate: float
    deactivate: float
    sample_every: int | None


@dataclass(frozen=True)
class Trial:
    """Result of a policy on one video: success AUC, and declared ms of the agents that looked, per frame."""

    auc: float
    cost_ms: float


@dataclass(frozen=True)
class Chosen:
    """The outcome of a search.

    Attributes:
        policy: the cheapest that loses at most `SPARED` of the graph's own AUC, with 95 % confidence.
        own: mean of the graph's own rules over all videos.
        trial: the same of the chosen policy.
        candidates: how many were tried.
        runs: in how many runs.
    """

    policy: Policy
    own: Trial
    trial: Trial
    candidates: int
    runs: int


def policy_of(adapt: Adapt | None) -> Policy:
    """The graph's own policy.

    Raises:
        ValueError: the rule that switches on, or the one that switches off, is missing or goes by no level of
            UD, or their levels differ in unit.
    """
    activate_above = None if adapt is None or adapt.activate is None else adapt.activate.above
    deactivate_below = None if adapt is None or adapt.deactivate is None else adapt.deactivate.below
    if (
        adapt is None
        or activate_above is None
        or deactivate_below is None
        or activate_above.kind != deactivate_below.kind
        or activate_above.kind == "score"
    ):
        raise ValueError(
            "policy: the root needs `adapt` with `activate: {above: ...}` and `deactivate: {below: ...}`, "
            "levels of UD in the same unit"
        )
    assert adapt.deactivate is not None
    return Policy(
        float(activate_above.settings), float(deactivate_below.settings), adapt.deactivate.sample_every
    )


def candidates(current: Policy) -> tuple[Policy, ...]:
    """The graph's own policy, and those around it that ask for less."""
    sampled = (
        (None, 3)
        if current.sample_every is None
        else (current.sample_every, current.sample_every + 1, 2 * current.sample_every)
    )
    policies = [
        Policy(_short(scale * current.activate), _short(scale * current.deactivate), sample_every)
        for scale, sample_every in product(SCALES, sampled)
    ]
    return tuple(dict.fromkeys([current, *policies]))


def _short(value: float) -> float:
    """Three digits, which is more than is known."""
    return float(f"{value:.3g}")


def search(
    tried: Sequence[Policy], videos: int, run: Callable[[Policy, int], Trial], seed: int = 0
) -> Chosen:
    """Successive halving: all candidates on a few videos, the better half on twice as many, and so on.

    What a policy loses against the first candidate is the 95 % bound of the mean over the same videos: with
    the mean alone the cheapest would be chosen of those that were lucky. Of the places of a round one half
    goes to the cheapest of those that lose at most `SPARED`, the other half to those that lose least. The
    first candidate, the graph's own policy, stays to the end and is chosen when no other that loses at most
    `SPARED` is cheaper.

    Args:
        tried: the candidates, the graph's own policy first.
        videos: how many there are.
        run: policy and number of a video -> what it gave.
        seed: of the order in which videos are taken.

    Raises:
        ValueError: fewer than two videos.
    """
    if videos < 2:
        raise ValueError(
            "policy: one video; two or more are needed, since what one can do without, another needs"
        )
    order = [int(k) for k in np.random.default_rng(seed).permutation(videos)]
    trial_of: dict[tuple[Policy, int], Trial] = {}
    current, remaining, count = tried[0], list(tried), min(FIRST_VIDEOS, videos)

    def trials(policy: Policy) -> list[Trial]:
        for video in order[:count]:
            if (policy, video) not in trial_of:
                trial_of[policy, video] = run(policy, video)
        return [trial_of[policy, video] for video in order[:count]]

    def loss(policy: Policy) -> float:
        less = [base.auc - trial.auc for base, trial in zip(trials(current), trials(policy), strict=True)]
        return float(np.mean(less) + CONFIDENCE * np.std(less, ddof=1) / np.sqrt(count))

    while True:
        losses, means = (
            {policy: loss(policy) for policy in remaining},
            {policy: mean(trials(policy)) for policy in remaining},
        )

        def rank(policy: Policy) -> tuple[float, float]:
            return max(losses[policy] - SPARED, 0.0), means[policy].cost_ms  # noqa: B023  called in this round

        cheap = sorted(remaining, key=rank)
        if count == videos:
            cheapest = cheap[0]
            if losses[cheapest] > SPARED or means[cheapest].cost_ms >= means[current].cost_ms:
                cheapest = current
            return Chosen(cheapest, means[current], means[cheapest], len(tried), len(trial_of))
        places = (len(remaining) + 1) // 2
        survivors = cheap[: (places + 1) // 2]
        accurate = sorted(remaining, key=lambda policy: (losses[policy], means[policy].cost_ms))
        survivors += [policy for policy in accurate if policy not in survivors][: places - len(survivors)]
        remaining = survivors if current in survivors else [*survivors, current]
        count = min(2 * count, videos)


def mean(trials: Sequence[Trial]) -> Trial:
    """The mean of each figure."""
    auc, cost = np.mean([(trial.auc, trial.cost_ms) for trial in trials], axis=0)
    return Trial(float(auc), float(cost))
