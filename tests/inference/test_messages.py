"""Messages: exact where states can be enumerated, unbiased where they are drawn, faults left out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.graph.spec import Noise
from bayesnet_track.inference.compile import compile_plan
from bayesnet_track.inference.gaussian_messages import grid_message, kernel_message
from bayesnet_track.inference.messages import evaluate, without
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.observation.cue import Hypotheses

PLACES = np.array([[10.0 * k, 5.0, 4.0, 4.0] for k in range(5)])
"""A state with five values."""

TABLES = {
    "a": np.log([0.9, 0.5, 0.1, 0.2, 0.7]),
    "b": np.log([0.3, 0.6, 0.9, 0.1, 0.2]),
    "c": np.log([0.05, 1.0, 0.4, 0.4, 0.8]),
}
BETA = np.log([0.1, 0.3, 0.2, 0.25, 0.15])


def table(values):
    """A likelihood that looks up its value by the place."""
    return lambda planes, h, reference: np.asarray(values)[np.rint(h.boxes[:, 0] / 10).astype(int)]


def at_places(fakes, nodes, sees, active=None, beta=BETA):
    plate, _ = fakes.plate(nodes)
    cues = {agent: fakes.Oracle(see) for agent, see in sees.items()}
    plan = compile_plan(plate, cues if active is None else active, cues)
    evidence = evaluate(plan, fakes.observer(cues), Hypotheses(PLACES), np.asarray(beta))
    return plan, evidence


def posterior(evidence, beta=BETA):
    return LogWeights(np.asarray(beta)).times(evidence.log_likelihood)[0].weights


def enumerated(joint):
    return joint / joint.sum()


def test_a_product_is_bayes_rule_by_enumeration(fakes):
    _, evidence = at_places(
        fakes,
        {"root": {"fuse": "product"}, **dict.fromkeys("abc", "root")},
        {k: table(TABLES[k]) for k in "abc"},
    )
    expected = enumerated(np.exp(BETA) * np.exp(TABLES["a"]) * np.exp(TABLES["b"]) * np.exp(TABLES["c"]))
    np.testing.assert_allclose(posterior(evidence), expected, rtol=1e-12)
    np.testing.assert_allclose(evidence.log_likelihood, sum(TABLES.values()), rtol=1e-14)
    assert set(evidence.messages) == {"a", "b", "c"} and not evidence.faults and not evidence.latent


def test_a_child_that_only_multiplies_is_the_flat_net(fakes):
    sees = {k: table(TABLES[k]) for k in "abc"}
    _, flat = at_places(fakes, {"root": {"fuse": "product"}, **dict.fromkeys("abc", "root")}, sees)
    _, deep = at_places(
        fakes,
        {
            "root": {"fuse": "product"},
            "n": {"parent": "root", "fuse": "product"},
            "a": "n",
            "b": "n",
            "c": "root",
        },
        sees,
    )
    np.testing.assert_allclose(deep.log_likelihood, flat.log_likelihood, rtol=1e-14)
    np.testing.assert_allclose(deep.messages["n"], TABLES["a"] + TABLES["b"], rtol=1e-14)


@pytest.mark.parametrize(
    ("pool", "active", "weights"),
    [
        ("pool", "abc", {"a": 1 / 3, "b": 1 / 3, "c": 1 / 3}),
        ("pool", "ac", {"a": 0.5, "c": 0.5}),
        ({"pool": {"a": 3.0, "b": 1.0, "c": 4.0}}, "abc", {"a": 0.375, "b": 0.125, "c": 0.5}),
        ({"pool": {"a": 3.0, "b": 1.0, "c": 4.0}}, "ab", {"a": 0.75, "b": 0.25}),
        ({"pool": {"a": 3.0, "b": 1.0, "c": 4.0}}, "c", {"c": 1.0}),
    ],
)
def test_a_pool_weighs_the_children_that_are_present(fakes, pool, active, weights):
    sees = {k: table(TABLES[k]) for k in "abc"}
    _, evidence = at_places(fakes, {"root": {"fuse": pool}, **dict.fromkeys("abc", "root")}, sees, active)
    expected = sum(weight * TABLES[child] for child, weight in weights.items())
    np.testing.assert_allclose(evidence.log_likelihood, expected, rtol=1e-14)


def test_a_pool_of_equal_children_says_what_each_says(fakes):
    sees = dict.fromkeys("abc", table(TABLES["a"]))
    _, evidence = at_places(fakes, {"root": {"fuse": "pool"}, **dict.fromkeys("abc", "root")}, sees)
    np.testing.assert_allclose(evidence.log_likelihood, TABLES["a"], rtol=1e-14)


def test_no_active_agent_says_nothing(fakes):
    _, evidence = at_places(fakes, {"root": {}, "a": "root"}, {"a": table(TABLES["a"])}, active="")
    assert evidence.log_likelihood.tolist() == [0.0] * 5
    assert evidence.messages == {}


FUSIONS = ("product", "pool", "latent")


@given(data=st.data())
def test_any_tree_equals_its_recursive_definition(fakes, data):
    """Against a recursion over the written tree, which shares nothing with the compiler."""
    inner = data.draw(st.integers(1, 5))
    kinds = [data.draw(st.sampled_from(FUSIONS[: 2 if k == 0 else 3])) for k in range(inner)]
    given_ = {"latent": {"given": {"sd_px": {"x": 6.0, "y": 6.0}}, "draw": "one"}}
    parents = {f"n{k}": f"n{data.draw(st.integers(0, k - 1))}" for k in range(1, inner)}
    nodes = {f"n{k}": {"fuse": given_ if kinds[k] == "latent" else kinds[k]} for k in range(inner)}
    for node, parent in parents.items():
        nodes[node]["parent"] = parent
    homes = [*nodes, *data.draw(st.lists(st.sampled_from(sorted(nodes)), max_size=4))]
    parents |= {f"a{k}": home for k, home in enumerate(homes)}
    agents = [f"a{k}" for k in range(len(homes))]
    active = data.draw(st.lists(st.sampled_from(agents), unique=True, min_size=1))
    sees = {agent: fakes.gaussian(3.0 * k, 5.0, 10.0 + k) for k, agent in enumerate(agents)}

    plate, _ = fakes.plate({**nodes, **{agent: parents[agent] for agent in agents}})
    cues = {agent: fakes.Oracle(see) for agent, see in sees.items()}
    hypotheses = Hypotheses(PLACES)
    evidence = evaluate(compile_plan(plate, active, cues), fakes.observer(cues), hypotheses, BETA)

    def seen_at(node):
        if node in evidence.latent:
            return evidence.latent[node]
        return hypotheses if node == "n0" else seen_at(parents[node])

    def message(node):
        if node in sees:
            return sees[node](None, seen_at(parents[node]), None) if node in active else None
        said = [m for m in (message(child) for child in parents if parents[child] == node) if m is not None]
        if not said:
            return None
        return np.mean(said, axis=0) if kinds[int(node[1:])] == "pool" else np.sum(said, axis=0)

    np.testing.assert_allclose(evidence.log_likelihood, message("n0"), rtol=1e-10)
    for node, sent in evidence.messages.items():
        np.testing.assert_allclose(sent, message(node), rtol=1e-10)


def test_without_an_agent_is_the_net_compiled_without_it(fakes):
    nodes = {
        "root": {"fuse": "product"},
        "pool": {"parent": "root", "fuse": {"pool": {"a": 0.3, "b": 1.7, "c": 2.1}}},
        **dict.fromkeys("abc", "pool"),
        "d": "root",
    }
    sees = {k: table(TABLES[k]) for k in "abc"} | {"d": table(TABLES["b"])}
    plan, evidence = at_places(fakes, nodes, sees)
    for agent in "abcd":
        _, other = at_places(fakes, nodes, sees, [k for k in sees if k != agent])
        left = without(plan, evidence, agent, Hypotheses(PLACES), BETA)
        np.testing.assert_array_equal(left["root"], other.log_likelihood)
        if agent != "d":
            np.testing.assert_array_equal(left["pool"], other.messages["pool"])
    assert "root" in without(plan, evidence, "d", Hypotheses(PLACES), BETA)


# ------------------------------------------------------------------------------------ latent states


def quadrature(likelihood, x, y, sd):
    """The integral of N(c; (x, y), sd^2) L(c) by 40 x 40 Gauss-Hermite nodes."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)
    xs, ys = np.meshgrid(x + sd * nodes, y + sd * nodes)
    boxes = np.column_stack([xs.ravel(), ys.ravel(), np.full((xs.size, 2), 4.0)])
    values = np.exp(likelihood(None, Hypotheses(boxes), None))
    return float(np.outer(weights, weights).ravel() @ values) / (2.0 * np.pi)


def two_bumps(planes, hypotheses, reference):
    """Far from Gaussian: two bumps of different width."""
    away = hypotheses.boxes[:, :2]
    near = -0.5 * np.sum((away - (4.0, 0.0)) ** 2, axis=1) / 9.0
    far = -0.5 * np.sum((away - (-9.0, 5.0)) ** 2, axis=1) / 25.0
    return np.logaddexp(near, np.log(0.4) + far) - np.log(1.4)


@pytest.mark.parametrize("at", [(0.0, 0.0), (12.0, -6.0), (-9.0, 5.0)])
def test_one_draw_is_unbiased(fakes, at):
    """The mean of exp(message) over draws is the integral, up to 4.5 standard errors of 40 000 draws."""
    plate, _ = fakes.plate(
        {
            "root": {},
            "c": {
                "parent": "root",
                "fuse": {"latent": {"given": {"sd_px": {"x": 6.0, "y": 6.0}}, "draw": "one"}},
            },
            "a": "c",
        }
    )
    cues = {"a": fakes.Oracle(two_bumps)}
    n = 40_000
    hypotheses = Hypotheses(np.tile([*at, 4.0, 4.0], (n, 1)))
    evidence = evaluate(
        compile_plan(plate, "a", cues), fakes.observer(cues), hypotheses, np.full(n, -np.log(n))
    )
    likelihoods = np.exp(evidence.log_likelihood)
    error = likelihoods.std() / np.sqrt(n)
    assert abs(likelihoods.mean() - quadrature(two_bumps, *at, 6.0)) < 4.5 * error
    drawn = evidence.latent["c"].boxes
    np.testing.assert_array_equal(drawn[:, 2:], 4.0)
    assert abs(drawn[:, :2].std(axis=0) - 6.0).max() < 4.5 * 6.0 / np.sqrt(2 * n)


def test_a_latent_within_a_latent_is_unbiased(fakes):
    """Sd 6 then 3 is sd sqrt(45) in one; the outer agent sees the outer state of the same hypothesis."""
    outer, inner = {"sd_px": {"x": 6.0, "y": 6.0}}, {"sd_px": {"x": 3.0, "y": 3.0}}
    nodes = {
        "root": {},
        "c": {"parent": "root", "fuse": {"latent": {"given": outer, "draw": "one"}}},
        "d": {"parent": "c", "fuse": {"latent": {"given": inner, "draw": "one"}}},
        "a": "d",
        "b": "c",
    }
    plate, _ = fakes.plate(nodes)
    n = 40_000
    hypotheses = Hypotheses(np.tile([1.0, 2.0, 4.0, 4.0], (n, 1)))
    beta = np.full(n, -np.log(n))

    def mean_and_error(sees):
        cues = {agent: fakes.Oracle(see) for agent, see in sees.items()}
        evidence = evaluate(compile_plan(plate, "ab", cues), fakes.observer(cues), hypotheses, beta)
        values = np.exp(evidence.log_likelihood)
        return values.mean(), values.std() / np.sqrt(n), evidence

    mean, error, evidence = mean_and_error({"a": two_bumps, "b": fakes.flat()})
    assert abs(mean - quadrature(two_bumps, 1.0, 2.0, np.sqrt(45.0))) < 4.5 * error
    steps = evidence.latent["d"].boxes - evidence.latent["c"].boxes
    assert abs(steps[:, :2].std(axis=0) - 3.0).max() < 4.5 * 3.0 / np.sqrt(2 * n)

    def through(planes, hypotheses_, reference):  # what the outer agent and the inner node say together of c
        bump = fakes.gaussian(0.0, 0.0, 5.0)(None, hypotheses_, None)
        square = np.sum((hypotheses_.boxes[:, :2] - (3.0, 0.0)) ** 2, axis=1)
        return bump + np.log(4.0**2 / (4.0**2 + 9.0)) - 0.5 * square / (4.0**2 + 9.0)

    mean, error, _ = mean_and_error({"a": fakes.gaussian(3.0, 0.0, 4.0), "b": fakes.gaussian(0.0, 0.0, 5.0)})
    assert abs(mean - quadrature(through, 1.0, 2.0, 6.0)) < 4.5 * error


KERNEL = Noise.model_validate({"sd_px": {"x": 6.0, "y": 6.0}})


def kernel_case(n=1500):
    """Samples of a wide proposal, weighted to a narrower prior off its centre, and their latent draws."""
    rng = np.random.default_rng(5)
    h = rng.normal(0.0, 15.0, (n, 2))
    log_beta = -0.5 * np.sum((h - 4.0) ** 2, axis=1) / 10.0**2 + 0.5 * np.sum(h**2, axis=1) / 15.0**2
    beta, _ = LogWeights.normalise(log_beta)
    own = h + rng.normal(0.0, 6.0, (n, 2))
    size = np.full((n, 2), 4.0)
    return Hypotheses(np.hstack([h, size])), Hypotheses(np.hstack([own, size])), beta.log


@pytest.mark.slow
def test_the_kernel_is_the_integral_whatever_the_prior_weights():
    """Every row is a self-normalised importance sample of p(c | h_i); its delta-method standard error is
    known. Of the rows with at least 30 effective samples 95 % must lie within 4 of them; the form without the
    division by the samples' density does not.
    """
    above, own, beta = kernel_case()
    message = kernel_message(KERNEL, above, own, beta, two_bumps(None, own, None))

    square = np.sum((above.boxes[:, None, :2] - own.boxes[None, :, :2]) ** 2, axis=2)
    kernel = np.exp(-0.5 * square / 36.0)
    share = kernel * (np.exp(beta) / (np.exp(beta) @ kernel))
    share /= share.sum(axis=1, keepdims=True)
    plain = kernel / kernel.sum(axis=1, keepdims=True)
    likelihood = np.exp(two_bumps(None, own, None))
    rows = np.flatnonzero(1.0 / np.sum(share**2, axis=1) > 30.0)[:120]
    assert len(rows) == 120
    exact = np.array([quadrature(two_bumps, *above.boxes[i, :2], 6.0) for i in rows])
    error = np.sqrt(np.sum((share[rows] * (likelihood - exact[:, None])) ** 2, axis=1))
    assert np.mean(np.abs(np.exp(message[rows]) - exact) < 4.0 * error) > 0.95
    assert np.mean(np.abs(plain[rows] @ likelihood - exact) < 4.0 * error) < 0.8


def test_the_kernel_of_a_flat_likelihood_says_nothing():
    above, own, beta = kernel_case(200)
    np.testing.assert_allclose(kernel_message(KERNEL, above, own, beta, np.full(200, -3.0)), -3.0, rtol=1e-12)


def test_the_kernel_keeps_to_coordinates_without_noise():
    """The size is the parent's own: with distinct sizes only the own draw is left, with two, two groups."""
    above, own, beta = kernel_case(40)
    likelihood = two_bumps(None, own, None)
    sizes = np.linspace(4.0, 9.0, 40)
    for boxes in (above.boxes, own.boxes):
        boxes[:, 2] = sizes
    np.testing.assert_allclose(kernel_message(KERNEL, above, own, beta, likelihood), likelihood, rtol=1e-12)
    for boxes in (above.boxes, own.boxes):
        boxes[:, 2] = np.repeat([4.0, 8.0], 20)
    both = kernel_message(KERNEL, above, own, beta, likelihood)
    for part in (slice(0, 20), slice(20, 40)):
        mine = LogWeights.normalise(beta[part])[0].log
        alone = kernel_message(
            KERNEL, Hypotheses(above.boxes[part]), Hypotheses(own.boxes[part]), mine, likelihood[part]
        )
        np.testing.assert_allclose(both[part], alone, rtol=1e-10)


def test_hypotheses_of_prior_weight_zero_do_not_count_in_the_kernel():
    above, own, beta = kernel_case(60)
    dead = beta.copy()
    dead[:20] = -np.inf
    likelihood = two_bumps(None, own, None)
    message = kernel_message(KERNEL, above, own, LogWeights.normalise(dead)[0].log, likelihood)
    alone = kernel_message(
        KERNEL,
        Hypotheses(above.boxes[20:]),
        Hypotheses(own.boxes[20:]),
        LogWeights.normalise(beta[20:])[0].log,
        likelihood[20:],
    )
    np.testing.assert_allclose(message[20:], alone, rtol=1e-10)
    for boxes in (above.boxes, own.boxes):
        boxes[:, 2] = np.linspace(4.0, 9.0, 60)
    assert np.isfinite(kernel_message(KERNEL, above, own, dead, likelihood)).all()


def test_the_kernel_step_is_the_kernel_message(fakes):
    """Through the plan, at the root's child and one level deeper, around the right parents."""
    latent = {"latent": {"given": {"sd_px": {"x": 6.0, "y": 6.0}}, "draw": "kernel"}}
    nodes = {
        "root": {},
        "c": {"parent": "root", "fuse": latent},
        "d": {"parent": "c", "fuse": latent},
        "a": "d",
    }
    plate, _ = fakes.plate(nodes)
    above, _, beta = kernel_case(80)
    cues = {"a": fakes.Oracle(two_bumps)}
    evidence = evaluate(compile_plan(plate, "a", cues), fakes.observer(cues), above, beta)
    c, d = evidence.latent["c"], evidence.latent["d"]
    inner = kernel_message(KERNEL, c, d, beta, two_bumps(None, d, None))
    np.testing.assert_allclose(evidence.messages["d"], inner, rtol=1e-12)
    np.testing.assert_allclose(
        evidence.log_likelihood, kernel_message(KERNEL, above, c, beta, inner), rtol=1e-12
    )


# ------------------------------------------------------------------------------------ on a grid


@pytest.mark.parametrize(
    "noise",
    [
        {"sd_px": {"x": 6.0, "y": 6.0}},
        {"sd_px": {"x": 3.0, "y": 9.0}},
        {"sd_px": {"x": 4.0, "y": 4.0}, "heavy_tail": {"weight": 0.3, "factor": 3.0}},
    ],
)
def test_the_grid_is_the_kernel_up_to_its_cells(noise):
    """With cells of a quarter of an sd the interpolation error is about (1/4)^4 / 100 of the values."""
    given_ = Noise.model_validate(noise)
    above, own, beta = kernel_case(800)
    likelihood = two_bumps(None, own, None)
    exact = kernel_message(given_, above, own, beta, likelihood)
    grid = grid_message(given_, above, own, beta, likelihood)
    weights = np.exp(beta)
    assert weights @ np.abs(grid - exact) < 0.01
    assert np.quantile(np.abs(grid - exact), 0.95) < 0.05


def test_the_grid_of_a_flat_likelihood_says_nothing():
    above, own, beta = kernel_case(300)
    np.testing.assert_allclose(grid_message(KERNEL, above, own, beta, np.full(300, -3.0)), -3.0, rtol=1e-9)


def test_the_grid_with_dead_hypotheses_and_no_likelihood():
    above, own, beta = kernel_case(200)
    dead = beta.copy()
    dead[:50] = -np.inf
    dead = LogWeights.normalise(dead)[0].log
    likelihood = two_bumps(None, own, None)
    message = grid_message(KERNEL, above, own, dead, likelihood)
    exact = kernel_message(KERNEL, above, own, dead, likelihood)
    assert np.exp(dead) @ np.abs(message - exact) < 0.01
    nowhere = grid_message(KERNEL, above, own, dead, np.full(200, -np.inf))
    assert (nowhere == -np.inf).all()
    few = np.full(200, -np.inf)
    few[60:70] = 0.0
    assert np.isfinite(grid_message(KERNEL, above, own, dead, few)[50:]).all()


def test_the_grid_of_scattered_hypotheses_stays_small():
    """An sd of 0.5 px over 4000 px would need a billion cells: they become coarser instead."""
    rng = np.random.default_rng(0)
    fine = Noise.model_validate({"sd_px": {"x": 0.5, "y": 0.5}})
    boxes = np.hstack([rng.uniform(0.0, 4000.0, (300, 2)), np.full((300, 2), 9.0)])
    own = boxes + np.hstack([rng.normal(0.0, 0.5, (300, 2)), np.zeros((300, 2))])
    beta = np.full(300, -np.log(300))
    message = grid_message(fine, Hypotheses(boxes), Hypotheses(own), beta, -rng.uniform(0.0, 3.0, 300))
    assert np.isfinite(message).all() and (message <= 1e-9).all()


def test_the_grid_step_is_the_grid_message(fakes):
    latent = {"latent": {"given": {"sd_px": {"x": 6.0, "y": 6.0}}}}
    nodes = {"root": {}, "c": {"parent": "root", "belief": "grid", "fuse": latent}, "a": "c"}
    plate, _ = fakes.plate(nodes)
    above, _, beta = kernel_case(80)
    cues = {"a": fakes.Oracle(two_bumps)}
    evidence = evaluate(compile_plan(plate, "a", cues), fakes.observer(cues), above, beta)
    own = evidence.latent["c"]
    np.testing.assert_array_equal(
        evidence.log_likelihood, grid_message(KERNEL, above, own, beta, two_bumps(None, own, None))
    )
