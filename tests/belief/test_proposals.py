"""The weights of second passes and other proposals, against what could have drawn them."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.belief.contract import Evidence
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.belief.particles.adaptive_size import evaluate_sample, move
from bayesnet_track.belief.particles.importance import (
    auxiliary_pass,
    combine,
    edit,
    mixture_pass,
    proposal_of,
    select_hypotheses,
)
from bayesnet_track.belief.particles.particle_set import Inputs, ParticleSet
from bayesnet_track.belief.particles.proposals import (
    STRETCH,
    Draws,
    Message,
    draw_by_parents,
    draw_fitted,
    fit_message,
    fit_proposal,
    flatten_to_ess,
    mix_defensive,
    paired_log_density,
)
from bayesnet_track.belief.particles.sample_size import WeightedSample, concatenate, prior_of
from bayesnet_track.graph import spec
from bayesnet_track.graph.settings.beliefs import (
    Auxiliary,
    LikelihoodMixture,
    PriorEditing,
    SecondPassProposal,
)
from bayesnet_track.numerics.gaussian import weighted_moments
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.observation.cue import Hypotheses

PLACE = np.array([104.0, 82.0])
SIZE = 30


def look(boxes):
    return -0.5 * ((boxes[:, :2] - PLACE) ** 2).sum(axis=1) / 9.0


def seen(hypotheses, prior_log):
    assert np.exp(prior_log).sum() == pytest.approx(1.0)
    return Evidence(look(hypotheses.boxes), {"a": 2 * look(hypotheses.boxes)})


@pytest.fixture
def inputs_of(motion_of, stream_of):
    rng = np.random.default_rng(8)
    states = np.column_stack([rng.normal(100, 4, SIZE), rng.normal(80, 3, SIZE), np.full((SIZE, 2), 20.0)])
    weights = LogWeights.normalise(0.7 * rng.standard_normal(SIZE))[0]
    motion = motion_of("random_walk", sd_px={"x": 3.0, "y": 2.0})

    def make(seed=0, evaluate=seen):
        prior = ParticleSet(states, ("x", "y", "w", "h"), weights)
        return Inputs(prior, motion, 1.0, evaluate, stream_of(seed, 1))

    return make


@pytest.fixture
def first_of():
    def make(inputs, size=SIZE):
        ancestors = np.repeat(np.arange(SIZE), 2)[:size]
        return evaluate_sample(
            inputs, move(inputs, ancestors, "first"), LogWeights.uniform(size).log, ancestors
        )

    return make


# ------------------------------------------------------------------------------------ auxiliary


@pytest.mark.parametrize("defensive", [0.0, 0.3])
def test_parents_are_drawn_by_their_look_and_weighted_by_the_inverse(defensive, inputs_of):
    inputs = inputs_of()
    beta, states = inputs.prior.weights.weights, inputs.prior.states
    one = auxiliary_pass(inputs, 200, Auxiliary(defensive=defensive))
    favoured = beta * np.exp(look(states))
    drawn_by = (1 - defensive) * favoured / favoured.sum() + defensive * beta
    np.testing.assert_allclose(np.exp(one.prior_log), (beta / (200 * drawn_by))[one.ancestors])
    assert np.abs(np.bincount(one.ancestors, minlength=SIZE) - 200 * drawn_by).max() < 1.0
    steps = one.states[:, :2] - states[one.ancestors, :2]
    np.testing.assert_allclose(steps.std(axis=0), [3.0, 2.0], rtol=0.2)  # 5 % of standard error each
    np.testing.assert_allclose(one.evidence.log_likelihood, look(one.states))


def test_where_nothing_fits_ahead_parents_are_drawn_by_their_weights(inputs_of):
    asked = []

    def blind_at_first(hypotheses, prior_log):
        asked.append(len(hypotheses))
        return Evidence(np.full(len(hypotheses), -np.inf) if len(asked) == 1 else look(hypotheses.boxes))

    inputs = inputs_of(evaluate=blind_at_first)
    one = auxiliary_pass(inputs, 100, Auxiliary())
    np.testing.assert_allclose(one.prior_log, -np.log(100))
    beta = inputs.prior.weights.weights
    assert np.abs(np.bincount(one.ancestors, minlength=SIZE) - 100 * beta).max() < 1.0 and asked == [
        SIZE,
        100,
    ]


# ------------------------------------------------------------------------------------ prior editing


def test_hypotheses_are_kept_by_their_likelihood_and_weighted_by_the_inverse(inputs_of, first_of):
    inputs = inputs_of()
    first = first_of(inputs)
    found = edit(inputs, first, PriorEditing(rounds=1, accept_above=0.5))
    log = first.evidence.log_likelihood
    others = [np.delete(log, i).max() for i in range(SIZE)]
    chance = np.minimum(1.0, np.exp(log - others) / 0.5)
    kept = inputs.stream("reject").random(SIZE) < chance
    kept[log.argmax()] = True
    assert 1 < kept.sum() < SIZE
    np.testing.assert_array_equal(found.states, first.states[kept])
    np.testing.assert_array_equal(found.ancestors, first.ancestors[kept])
    np.testing.assert_allclose(np.exp(found.prior_log), 1 / (SIZE * chance[kept]))
    np.testing.assert_array_equal(found.evidence.log_likelihood, log[kept])
    np.testing.assert_array_equal(found.evidence.messages["a"], 2 * log[kept])


def test_rounds_are_drawn_from_the_prior_and_share_its_weight(inputs_of, first_of):
    inputs = inputs_of()
    first = first_of(inputs)
    found = edit(inputs, first, PriorEditing(rounds=3, accept_above=1e-9))  # all are kept
    assert len(found) == 3 * SIZE
    likely = look(found.states) > np.log(1e-9) + look(found.states).max()
    np.testing.assert_allclose(found.prior_log[likely], -np.log(3 * SIZE))
    beta = inputs.prior.weights.weights
    again = np.bincount(found.ancestors, minlength=SIZE) - np.bincount(first.ancestors, minlength=SIZE)
    assert likely.all() and np.abs(again - 2 * SIZE * beta).max() < 1.0


def test_evidence_that_says_nothing_edits_nothing(inputs_of, first_of):
    for nothing in (-np.inf, np.nan, np.inf):
        inputs = inputs_of(evaluate=lambda h, p, nothing=nothing: Evidence(np.full(len(h), nothing)))
        first = first_of(inputs)
        assert edit(inputs, first, PriorEditing(rounds=1)) is first


def test_a_part_of_a_pass_has_its_part_of_all_evidence():
    latent = {"n": Hypotheses(np.arange(16.0).reshape(4, 4), {"v": np.arange(4.0)})}
    evidence = Evidence(np.arange(4.0), {"a": np.arange(4.0) + 10}, latent, sampled=np.arange(4.0) + 20)
    one = WeightedSample(np.arange(20.0).reshape(4, 5), -np.arange(4.0), np.array([3, 2, 1, 0]), evidence)
    part = select_hypotheses(one, np.array([2, 0]))
    assert part.states.tolist() == [[10, 11, 12, 13, 14], [0, 1, 2, 3, 4]]
    assert part.prior_log.tolist() == [-2, 0] and part.ancestors.tolist() == [1, 3]
    assert part.evidence.log_likelihood.tolist() == [2, 0] and part.evidence.messages["a"].tolist() == [
        12,
        10,
    ]
    assert part.evidence.latent["n"].boxes.tolist() == [[8, 9, 10, 11], [0, 1, 2, 3]]
    assert part.evidence.latent["n"].fields["v"].tolist() == [2, 0]
    assert part.evidence.sampled.tolist() == [22, 20]
    assert (
        select_hypotheses(
            WeightedSample(one.states, one.prior_log, one.ancestors, Evidence(np.arange(4.0))), [1]
        ).evidence.sampled
        is None
    )


# ------------------------------------------------------------------------------------ a sample of the prior


def both_of(inputs, first, draws, weights):
    second = evaluate_sample(
        inputs, draws.states, LogWeights.normalise(draws.log_alone)[0].log, draws.ancestors
    )
    return combine(first, second, draws, weights)


METHODS = {
    "auxiliary": lambda inputs, first: auxiliary_pass(inputs, SIZE, Auxiliary()),
    "mixture": lambda inputs, first: mixture_pass(inputs, SIZE, LikelihoodMixture(share=0.5)),
    "parents": lambda inputs, first: (
        both_of(
            inputs,
            first,
            draw_by_parents(inputs, first, SecondPassProposal(by="parents", neighbours=1)),
            "second_only",
        ).whole
    ),
    "groups": lambda inputs, first: (
        both_of(
            inputs,
            first,
            draw_by_parents(inputs, first, SecondPassProposal(by="parents", neighbours=4)),
            "separate",
        ).whole
    ),
    "fitted": lambda inputs, first: (
        both_of(inputs, first, draw_fitted(inputs, first, SecondPassProposal()), "second_only").whole
    ),
}


@pytest.mark.parametrize("method", METHODS)
def test_weighted_hypotheses_are_a_sample_of_the_prior(method, inputs_of):
    """Sums over them have the prior's as their means: the number 1, and x and its square about the mean."""
    found = []
    for seed in range(60):
        inputs = inputs_of(seed)
        beta = inputs.prior.weights.weights
        ancestors = np.random.default_rng(seed).choice(SIZE, SIZE, p=beta)
        states = move(inputs, ancestors, "first")
        first = evaluate_sample(inputs, states, LogWeights.uniform(SIZE).log, ancestors)
        one = METHODS[method](inputs, first)
        w, x = np.exp(one.prior_log), one.states[:, 0]
        found.append([w.sum(), w @ (x - 100.0), w @ (x - 100.0) ** 2])
        np.testing.assert_allclose(one.evidence.log_likelihood, look(one.states))
    mean, variance = weighted_moments(inputs.prior.states[:, :1] - 100.0, beta)
    exact = [1.0, mean[0], mean[0] ** 2 + variance[0, 0] + 9.0]
    error = np.std(found, axis=0, ddof=1) / np.sqrt(len(found))
    assert (np.abs(np.mean(found, axis=0) - exact) < 4 * error + 1e-9).all()


def test_a_mixture_never_weighs_more_than_the_plain_draws(inputs_of):
    one = mixture_pass(inputs_of(), 40, LikelihoodMixture(share=0.25))
    assert len(one) == 40 and one.prior_log.max() <= -np.log(30)
    plain = mixture_pass(inputs_of(), 40, LikelihoodMixture(share=0.001))  # rounds to none
    np.testing.assert_allclose(plain.prior_log, -np.log(40))


# ------------------------------------------------------------------------------------ two passes


@pytest.mark.parametrize("weights", ["balance", "separate", "second_only"])
def test_two_passes_weigh_by_what_could_have_drawn_them(weights, inputs_of, first_of, rng):
    inputs = inputs_of()
    first = first_of(inputs)
    draws = Draws(inputs.prior.states[:20] + 0.5, np.arange(20), rng.normal(size=20), rng.normal(size=SIZE))
    both = both_of(inputs, first, draws, weights)
    n, m, r, r_first = SIZE, 20, np.exp(draws.log_ratio), np.exp(draws.log_ratio_first)
    likelihood = np.exp(look(draws.states))
    assert both.log_second == pytest.approx(np.log((likelihood / r).sum() / m))
    expected = {
        "balance": np.r_[1 / (n + m * r_first), 1 / (n + m * r)],
        "separate": np.r_[np.full(n, 1 / (n + m)), 1 / (r * (n + m))],
        "second_only": 1 / (m * r),
    }[weights]
    np.testing.assert_allclose(np.exp(both.whole.prior_log), expected)
    states = draws.states if weights == "second_only" else np.concatenate([first.states, draws.states])
    np.testing.assert_array_equal(both.whole.states, states)
    np.testing.assert_allclose(both.whole.evidence.log_likelihood, look(states))
    np.testing.assert_array_equal(both.whole.ancestors[-20:], np.arange(20))


def test_parents_that_did_well_are_drawn_more_often(inputs_of, first_of):
    inputs = inputs_of()
    first = first_of(inputs)
    likelihood = np.exp(look(first.states))
    draws = draw_by_parents(inputs, first, SecondPassProposal(by="parents", neighbours=1, defensive=0.2))
    ratio = 0.2 + 0.8 * likelihood / likelihood.mean()
    np.testing.assert_allclose(np.exp(draws.log_ratio_first), ratio)
    drawn_by = np.bincount(first.ancestors, ratio, SIZE)
    counts = np.bincount(draws.ancestors, minlength=SIZE)
    assert np.abs(counts - drawn_by).max() < 2.0  # each parent twice in the first pass, at most
    of_parent = [np.log(ratio[first.ancestors == parent]) for parent in range(SIZE)]
    for parent, log in zip(draws.ancestors, draws.log_ratio, strict=True):
        assert np.isclose(of_parent[parent], log).any()


def test_mixed_with_the_prior_a_ratio_has_a_floor():
    np.testing.assert_allclose(np.exp(mix_defensive(np.log([0.5, 3.0]), 0.2)), [0.6, 2.6])
    assert mix_defensive(np.array([-np.inf]), 0.2)[0] == pytest.approx(np.log(0.2))
    assert mix_defensive(np.array([-1.0]), 0.0).tolist() == [-1.0]


def test_passes_are_joined_with_their_shares():
    one = WeightedSample(
        np.zeros((2, 4)),
        np.log([0.5, 0.5]),
        np.array([0, 1]),
        Evidence(np.zeros(2), {"a": np.ones(2)}, sampled=np.zeros(2)),
    )
    two = WeightedSample(
        np.ones((1, 4)),
        np.zeros(1),
        np.array([7]),
        Evidence(np.ones(1), {"a": np.zeros(1)}, sampled=np.ones(1)),
    )
    both = concatenate(one, two, 0.25)
    np.testing.assert_allclose(np.exp(both.prior_log), [0.125, 0.125, 0.75])
    assert both.ancestors.tolist() == [0, 1, 7] and both.states[:, 0].tolist() == [0, 0, 1]
    assert both.evidence.log_likelihood.tolist() == [0, 0, 1] and both.evidence.messages["a"].tolist() == [
        1,
        1,
        0,
    ]
    assert both.evidence.sampled.tolist() == [0, 0, 1]
    other_net = WeightedSample(
        two.states, two.prior_log, two.ancestors, Evidence(np.ones(1), faults={"a": "raised"})
    )
    assert concatenate(one, other_net, 0.25) is one
    np.testing.assert_allclose(prior_of(both).weights, [0.125, 0.125, 0.75])
    np.testing.assert_allclose(
        prior_of(WeightedSample(one.states, np.log([1.0, 3.0]), one.ancestors, one.evidence)).weights,
        [0.25, 0.75],
    )


# ------------------------------------------------------------------------------------ the fitted proposal

SHARES = np.array([0.8, 0.2])
MEANS = np.array([[0.0, 0.0], [3.0, -1.0]])
SDS = np.array([[[1.0, 2.0], [1.5, 1.0]], [[3.0, 6.0], [4.5, 3.0]]])
TRANSITION = Transition(lambda x: (x, np.zeros(len(x))), MEANS, SDS, np.log(SHARES))
BETA = LogWeights(np.log([0.3, 0.7]))
MESSAGE = Message(np.array([[0.5, 0.2], [0.2, 0.3]]), np.array([0.7, -0.4]))


def paired(points, k):
    """p(x | k) of points (..., 2)."""
    total = 0.0
    for share, sds in zip(SHARES, SDS[:, k], strict=True):
        density = np.exp(-0.5 * (((points - MEANS[k]) / sds) ** 2).sum(axis=-1)) / (2 * np.pi * sds.prod())
        total = total + share * density
    return total


def test_the_density_of_a_pair_is_the_motions_mixture(rng):
    points, parents = rng.normal(0, 3, (6, 2)), np.array([0, 1, 1, 0, 1, 0])
    exact = [paired(x, k) for x, k in zip(points, parents, strict=True)]
    np.testing.assert_allclose(np.exp(paired_log_density(TRANSITION, points, parents)), exact)


def test_the_proposal_is_the_motion_times_the_message_normalised():
    """By a sum over a grid that both fill: 60 x 60 px in steps of a quarter of the least sd."""
    proposal = fit_proposal(TRANSITION, BETA, MESSAGE)
    line = np.arange(-30, 30, 0.25)
    grid = np.stack(np.meshgrid(line, line), axis=-1)
    message = np.exp(
        grid @ MESSAGE.information - 0.5 * np.einsum("...i,ij,...j->...", grid, MESSAGE.precision, grid)
    )
    joint = np.stack([BETA.weights[k] * paired(grid, k) * message for k in (0, 1)])
    joint /= joint.sum() * 0.25**2
    for k in (0, 1):
        picked = grid[100:140:7, 100:140:7].reshape(-1, 2)
        found = np.exp(proposal.log_density(picked, np.full(len(picked), k)))
        np.testing.assert_allclose(found, joint[k, 100:140:7, 100:140:7].ravel(), rtol=1e-8)
    shares = joint.sum(axis=(1, 2)) * 0.25**2
    np.testing.assert_allclose(np.exp(proposal.log_shares).sum(axis=0), shares, rtol=1e-8)
    parents, points = proposal.draw(1000, np.random.default_rng(0))
    assert np.abs(np.bincount(parents) - 1000 * shares).max() < 2.0
    mean = np.einsum("kyx,yxi->i", joint, grid) * 0.25**2
    spread = np.einsum("kyx,yxi,yxj->ij", joint, grid - mean, grid - mean) * 0.25**2
    np.testing.assert_allclose(points.mean(axis=0), mean, atol=4 * np.sqrt(np.diag(spread).max() / 1000))
    np.testing.assert_allclose(np.cov(points.T), spread, atol=0.2 * np.diag(spread).max())


def test_a_message_turns_the_priors_moments_into_the_posteriors(rng):
    points = rng.normal(0, 1, (400, 2)) @ np.array([[2.0, 0.5], [0.0, 1.0]]) + [5.0, 7.0]
    log = -0.5 * ((points - [6.0, 6.5]) ** 2 / [1.0, 0.5]).sum(axis=1)
    beta = LogWeights.normalise(0.3 * rng.standard_normal(400))[0]
    message = fit_message(points, beta, log, effective=4)
    posterior = beta.times(log)[0]
    centre, spread = weighted_moments(points, beta.weights)
    mean, covariance = weighted_moments(points, posterior.weights)
    total = np.linalg.inv(spread) + message.precision
    np.testing.assert_allclose(np.linalg.inv(total), covariance, rtol=1e-5)
    at = np.linalg.solve(total, np.linalg.solve(spread, centre) + message.information)
    np.testing.assert_allclose(at, mean, rtol=1e-6)


def test_directions_of_which_nothing_is_told_get_no_precision(rng):
    points = rng.normal(0, 1, (400, 2))
    points -= points.mean(axis=0)
    beta = LogWeights.uniform(400)
    message = fit_message(points, beta, np.zeros(400))
    np.testing.assert_allclose(message.precision, 0.0, atol=1e-6)
    wide = fit_message(points, beta, 0.1 * points[:, 0] ** 2, effective=4)  # wider in x than the prior
    assert abs(wide.precision[0, 0]) < 0.05


def test_a_sharp_likelihood_is_flattened_until_enough_count_and_sharpened_twice_at_most(rng):
    points = rng.normal(0, 1, (100, 1))
    beta, log = LogWeights.uniform(100), -0.5 * ((points[:, 0] - 2.5) / 0.02) ** 2
    power, weights = flatten_to_ess(beta, log, 25.0)
    assert weights.ess >= 25.0 > beta.times(power / 0.8 * log)[0].ess
    assert np.log(power) / np.log(0.8) == pytest.approx(round(np.log(power) / np.log(0.8)))
    assert flatten_to_ess(beta, 0.01 * log / 2500, 25.0)[0] == 1.0
    message = fit_message(points, beta, log)
    mild = fit_message(points, beta, power * log, effective=1)
    np.testing.assert_allclose(message.precision, STRETCH * mild.precision, rtol=1e-6)


# ------------------------------------------------------------------------------------ which of them


def particles(importance, size=SIZE, **more):
    return spec.Particles.model_validate({"size": size, "proposal": importance, **more})


def draw_sample(settings, inputs):
    """What a filter with these settings draws, and edits or adds."""
    draw, refine = proposal_of(settings)
    first = draw(inputs)
    return first if refine is None else refine(inputs, first)


KLD = {"kld": {"bin_px": 2.0, "fields": ["x"]}}


def test_a_fixed_number_is_remembered_by_no_method(inputs_of):
    for importance, number in (
        ("bootstrap", SIZE),
        ("auxiliary", SIZE),
        ({"second_pass": {"above_kl": 1e9}}, SIZE),
        ({"second_pass": {"above_kl": 0.0}}, 2 * SIZE),
    ):
        found = draw_sample(particles(importance), inputs_of())
        assert len(found.whole) == number and found.size_memory is None and found.reports == ()
        assert (found.log_evidence is None) == (number == SIZE)


def test_an_adaptive_number_is_remembered_with_or_without_a_second_look(inputs_of):
    """PriorEditing and a first pass alone remember the first pass; a second pass has a say of its own."""
    plain = draw_sample(particles("bootstrap", KLD, min=100, max=200), inputs_of())
    assert plain.size_memory is not None
    edited_ = draw_sample(particles({"prior_editing": {"rounds": 2}}, KLD, min=100, max=200), inputs_of())
    assert edited_.size_memory.wanted == plain.size_memory.wanted and len(edited_.reports) == len(
        plain.reports
    )
    quiet = draw_sample(particles({"second_pass": {"above_kl": 1e9}}, KLD, min=100, max=200), inputs_of())
    assert quiet.size_memory.wanted == plain.size_memory.wanted
    np.testing.assert_array_equal(quiet.whole.states, plain.whole.states)
    always = draw_sample(particles({"second_pass": {"above_kl": 0.0}}, KLD, min=100, max=200), inputs_of())
    assert len(always.whole) > len(plain.whole) and always.size_memory.wanted != plain.size_memory.wanted
    assert always.log_evidence is not None
