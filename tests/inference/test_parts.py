"""Parts: beliefs against enumeration, and against the exact joint posterior of a linear Gaussian model."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from bayesnet_track.graph.spec import Given
from bayesnet_track.inference.compile import describe_plan
from bayesnet_track.inference.parts import nominal_boxes, part_beliefs, part_boxes, part_of_agents
from bayesnet_track.numerics.log_weights import LogWeights

Z = 4.5
"""Standard errors: a right value is missed once in 150,000 comparisons."""


def part(parent, own, x=0.0, y=0.0, w=1.0, h=1.0, sd=3.0, sd_size=0.0):
    """A node that is a part, held in the way `own`: by a draw, a belief or, as "default", what fits."""
    given = {
        "offset_box": {"x": x, "y": y},
        "size_box": {"w": w, "h": h},
        "sd_px": {"x": sd, "y": sd, "w": sd_size, "h": sd_size},
    }
    latent = {"given": given} | ({"draw": own} if own in ("one", "kernel") else {})
    belief = {"belief": own} if own in ("gaussian", "grid") else {}
    return {"parent": parent, "fuse": {"latent": latent}, **belief}


def believed(plan, evidence, beta):
    posterior = LogWeights.normalise(beta + evidence.log_likelihood)[0]
    return posterior, part_beliefs(plan, evidence, posterior)


def spread(weights, values):
    """Mean of the values under the weights, and its standard error by the delta method."""
    mean = weights @ values
    return mean, np.sqrt(weights**2 @ (values - mean) ** 2)


def written_part(parent, own, x=0.0, sd=3.0):
    """The same part, by expressions."""
    given = {"x": f"normal(parent.x + {x} * parent.w, {sd})", "y": f"normal(parent.y, {sd})"}
    return {"parent": parent, "fuse": {"latent": {"given": given, "draw": own}}}


@pytest.mark.parametrize("part", [part, written_part])
@pytest.mark.parametrize(("own", "copies"), [("one", 2000), ("kernel", 200)])
def test_the_marginal_of_a_part_is_that_of_enumeration(asked, own, copies, part):
    """Five places of the whole, cells of 10 px that two parts may lie in, a table of likelihoods for each.

    The exact joint is summed over all cells of both parts; p(cell | place) are areas under a Gaussian.
    """
    places = 10.0 * np.arange(5)
    beta = np.array([0.1, 0.3, 0.2, 0.25, 0.15])
    cells = np.arange(-6, 12)
    rng = np.random.default_rng(4)
    tables = {name: rng.uniform(0.02, 1.0, len(cells)) for name in ("a", "b")}

    def looks_up(name):
        at = lambda h: np.clip(np.rint(h.boxes[:, 0] / 10).astype(int), cells[0], cells[-1]) - cells[0]  # noqa: E731
        return lambda planes, h, reference: np.log(tables[name][at(h)])

    nodes = {
        "root": {"fuse": "product"},
        "left": part("root", own, x=-0.5, sd=7.0),
        "right": part("root", own, x=0.25, sd=9.0),
        "a": "left",
        "b": "right",
    }
    boxes = np.repeat(np.stack([[x, 5.0, 40.0, 4.0] for x in places]), copies, axis=0)
    log = np.repeat(np.log(beta / copies), copies)
    plan, evidence = asked(nodes, {name: looks_up(name) for name in tables}, boxes, beta=log)
    root, parts = believed(plan, evidence, log)

    def shares(offset, sd):
        """(place, cell) p(cell of the part | place of the whole)."""
        edges = 10.0 * cells[None] - (places[:, None] + offset)
        return norm.cdf((edges + 5.0) / sd) - norm.cdf((edges - 5.0) / sd)

    left, right = shares(-20.0, 7.0) * tables["a"], shares(10.0, 9.0) * tables["b"]
    joint = beta[:, None, None] * left[:, :, None] * right[:, None, :]
    joint /= joint.sum()
    cell_of = lambda own_boxes: np.rint(own_boxes[:, 0] / 10).astype(int)  # noqa: E731
    for name, exact in (("left", joint.sum(axis=(0, 2))), ("right", joint.sum(axis=(0, 1)))):
        weights, at = parts[name].weights.weights, cell_of(parts[name].boxes)
        for k in np.flatnonzero(exact > 0.01):
            share, error = spread(weights, (at == cells[k]).astype(float))
            assert share == pytest.approx(exact[k], abs=Z * error), (name, cells[k])
    for k, x in enumerate(places):
        share, error = spread(root.weights, (boxes[:, 0] == x).astype(float))
        # The kernel shares what all draws have seen: its error is larger than that of N independent draws.
        assert share == pytest.approx(joint.sum(axis=(1, 2))[k], abs=Z * error * (1 if own == "one" else 3))


OFFSETS = {"head": -0.4, "torso": 0.1, "badge": -0.25}
SDS = {"head": 4.0, "torso": 5.0, "badge": 2.0}
SCALES = {"head": 0.2, "torso": 0.5, "badge": 0.1}
SEEN = {"head": (30.0, 3.0), "badge": (71.0, 4.0)}
"""Part -> where its agent sees it, and the agent's sd. The torso has none of its own."""


def linear_gaussian(seen):
    """Mean (4,) and covariance (4, 4) of the rows of whole, head, torso, badge: solved as a linear system.

    The whole's row is N(60, 8^2), its height 100 px. A part lies its offset times its parent's height below
    its parent, with its sd: three linear relations, and a measurement for each part that is seen.
    """
    rows = [([1, 0, 0, 0], 60.0, 8.0)]
    rows.append(([-1, 1, 0, 0], 100.0 * OFFSETS["head"], SDS["head"]))
    rows.append(([-1, 0, 1, 0], 100.0 * OFFSETS["torso"], SDS["torso"]))
    rows.append(([0, 0, -1, 1], 100.0 * SCALES["torso"] * OFFSETS["badge"], SDS["badge"]))
    rows += [([0, name == "head", 0, name == "badge"], *seen[name]) for name in seen]
    matrix = np.array([np.array(row, float) / sd for row, _, sd in rows])
    precision = matrix.T @ matrix
    covariance = np.linalg.inv(precision)
    return covariance @ matrix.T @ np.array([value / sd for _, value, sd in rows]), covariance


@pytest.mark.parametrize("hidden", [None, "head", "badge"])
@pytest.mark.parametrize(
    ("own", "size"),
    [("one", 20_000), ("kernel", 1_000), ("grid", 4_000), ("gaussian", 4_000), ("default", 4_000)],
)
def test_whole_and_parts_have_the_exact_joint_posterior(asked, fakes, own, size, hidden):
    """A part of the whole, and a part of a part; an agent that sees nothing says the same of every place.

    The tolerance is `Z` standard errors of the weighted draws, and 6 % of the sd for what the kernel, the
    grid and the match to a Gaussian add by the finite number of draws that all hypotheses share.
    """
    nodes = {
        "root": {"fuse": "product"},
        **{
            name: part(
                "torso" if name == "badge" else "root", own, y=OFFSETS[name], h=SCALES[name], sd=SDS[name]
            )
            for name in OFFSETS
        },
        "a": "head",
        "b": "badge",
    }
    seen = {name: place for name, place in SEEN.items() if name != hidden}

    def sees(name):
        if name not in seen:
            return fakes.flat(np.log(0.02))
        row, sd = seen[name]
        return lambda planes, h, reference: -0.5 * ((h.boxes[:, 1] - row) / sd) ** 2

    rng = np.random.default_rng(11)
    boxes = np.tile([50.0, 60.0, 40.0, 100.0], (size, 1))
    boxes[:, :2] += 8.0 * rng.standard_normal((size, 2))
    beta = np.full(size, -np.log(size))
    plan, evidence = asked(nodes, {"a": sees("head"), "b": sees("badge")}, boxes, beta=beta)
    root, parts = believed(plan, evidence, beta)
    mean, covariance = linear_gaussian(seen)
    beliefs = {"root": (boxes, root), **{name: (p.boxes, p.weights) for name, p in parts.items()}}
    assert list(beliefs) == ["root", "head", "torso", "badge"]
    shared = 0.0 if own == "one" else 0.06
    for k, (name, (at, weights)) in enumerate(beliefs.items()):
        sd = np.sqrt(covariance[k, k])
        found, error = spread(weights.weights, at[:, 1])
        assert found == pytest.approx(mean[k], abs=Z * error + shared * sd), name
        variance, error = spread(weights.weights, (at[:, 1] - found) ** 2)
        assert variance == pytest.approx(sd**2, abs=Z * error + 2 * shared * sd**2), name


def test_a_measurement_of_a_part_is_exact_about_the_whole(asked, measuring):
    """Of a part's x and y, whose parent varies in size: log N(z; A h, R + Q) but for a constant.

    What a Gaussian node does not know it sends with a precision of a millionth of the prior's: 1e-4 nats.
    """
    nodes = {"root": {}, "head": part("root", "gaussian", x=0.1, y=-0.4, w=0.5, h=0.25, sd=2.0, sd_size=1.0)}
    rng = np.random.default_rng(3)
    boxes = np.array([50.0, 60.0, 40.0, 100.0]) + rng.standard_normal((500, 4)) * [8.0, 8.0, 3.0, 5.0]
    cue = measuring.place(55.0, 18.0, sd=3.0)
    _, evidence = asked({**nodes, "a": "head"}, {"a": cue}, boxes)
    away = np.stack([boxes[:, 0] + 0.1 * boxes[:, 2] - 55.0, boxes[:, 1] - 0.4 * boxes[:, 3] - 18.0], axis=1)
    exact = -0.5 * np.sum(away**2, axis=1) / (3.0**2 + 2.0**2)
    message = evidence.messages["head"]
    assert np.ptp(message - exact) < 1e-3
    assert set(evidence.gaussians) == {"head"}


@pytest.mark.parametrize("pool", [False, True])
def test_a_part_without_working_agents_is_still_drawn_and_believed(asked, fakes, pool):
    """Its belief is the whole's, moved to its place and wider by `given`."""
    nodes = {
        "root": {"fuse": "pool" if pool else "product"},
        "head": part("root", "one", y=-0.4),
        "a": "head",
    }
    boxes = np.tile([50.0, 60.0, 40.0, 100.0], (20_000, 1))
    boxes[:, 1] += 8.0 * np.random.default_rng(1).standard_normal(20_000)
    sees = {"a": fakes.flat(), "b": fakes.gaussian(50.0, 66.0, 4.0)}
    plan, evidence = asked({**nodes, "b": "root"}, sees, boxes, active="b")
    assert "draw     head given a part of root" in describe_plan(plan)
    root, parts = believed(plan, evidence, np.full(20_000, -np.log(20_000)))
    mean = root.weights @ boxes[:, 1]
    variance = root.weights @ (boxes[:, 1] - mean) ** 2
    error = np.sqrt((variance + 9.0) / root.ess)
    assert parts["head"].mean[1] == pytest.approx(mean - 40.0, abs=Z * error)
    wider = np.sqrt(2 / root.ess) * (variance + 9.0)
    assert parts["head"].sd[1] ** 2 == pytest.approx(variance + 9.0, abs=Z * wider)


def test_where_parts_lie_and_who_looks_at_them(fakes):
    plate, _ = fakes.plate(
        {
            "root": {"fuse": "product"},
            "torso": {**part("root", "one", x=0.1, y=0.2, w=0.5, h=0.5)},
            "color": {"parent": "torso", "fuse": "pool"},
            "badge": part("torso", "one", x=-0.5, h=0.1),
            **{"a": "color", "b": "color", "c": "badge", "d": "root"},
        }
    )
    boxes = nominal_boxes(plate, np.array([100.0, 50.0, 40.0, 80.0]), {})
    assert boxes["torso"].tolist() == [104.0, 66.0, 20.0, 40.0]
    assert boxes["badge"].tolist() == [94.0, 66.0, 20.0, 4.0]
    assert part_of_agents(plate) == {"a": "torso", "b": "torso", "c": "badge"}


def test_a_latent_node_that_is_no_part_keeps_its_parents_boxes():
    boxes = np.ones((3, 4))
    assert part_boxes(Given(sd_px={"x": 1}), boxes) is boxes


def test_parts_of_no_weight_fall_back_to_the_whole(asked, fakes):
    """The kernel may weigh a hypothesis whose own draw has no weight: with no draw left, the root's count."""
    nodes = {"root": {}, "p": part("root", "kernel", x=0.5), "a": "p"}
    boxes = np.tile([50.0, 60.0, 40.0, 100.0], (30, 1))
    plan, evidence = asked(nodes, {"a": fakes.flat()}, boxes)
    only_first = LogWeights.normalise(np.where(np.arange(30) == 0, 0.0, -np.inf))[0]
    evidence.messages["a"][0] = -np.inf
    assert part_beliefs(plan, evidence, only_first)["p"].weights is only_first


def test_by_default_a_latent_node_sends_the_integral(asked, fakes):
    """Against the closed form, mean over the belief; an agent tells about fifteen draws apart.

    A grid has their sampling error, 1 / sqrt(15) = 0.26 nats. One draw has that of a single draw.
    """
    sides = 2.0 * np.arange(50)
    boxes = np.column_stack([*(one.ravel() for one in np.meshgrid(sides, sides)), np.full((2500, 2), 20.0)])
    beta = -0.5 * ((boxes[:, :2] - 50.0) ** 2).sum(axis=1) / 20.0**2
    beta = LogWeights.normalise(beta)[0].log
    nodes = {"root": {}, "n": {"parent": "root", "fuse": {"latent": {"given": {"sd_px": {"x": 6, "y": 6}}}}}}
    sees = {"a": fakes.gaussian(44.0, 61.0, 3.0)}
    exact = np.log(9 / 45) - 0.5 * ((boxes[:, :2] - [44.0, 61.0]) ** 2).sum(axis=1) / (3.0**2 + 6.0**2)
    posterior = LogWeights.normalise(beta + exact)[0].weights
    off = {}
    for draw in (None, "one"):
        own = {
            **nodes["n"],
            "fuse": {"latent": {**nodes["n"]["fuse"]["latent"], **({"draw": draw} if draw else {})}},
        }
        _, evidence = asked({**nodes, "n": own, "a": "n"}, sees, boxes, beta=beta)
        off[draw] = posterior @ np.abs(evidence.log_likelihood - exact)
    assert off[None] < 0.6 and off["one"] > 5.0, off


def test_by_default_what_is_measured_below_a_latent_node_is_exact(asked, measuring):
    """log N(z; h, R + Q) but for a constant, to 1e-4 nats."""
    given = {"sd_px": {"x": 6, "y": 6}}
    nodes = {"root": {}, "n": {"parent": "root", "fuse": {"latent": {"given": given}}}, "a": "n"}
    boxes = np.array([50.0, 60.0, 40.0, 40.0]) + np.random.default_rng(3).standard_normal((500, 4)) * [
        9,
        9,
        0,
        0,
    ]
    _, evidence = asked(nodes, {"a": measuring.place(44.0, 61.0)}, boxes)
    exact = -0.5 * ((boxes[:, :2] - [44.0, 61.0]) ** 2).sum(axis=1) / (3.0**2 + 6.0**2)
    assert np.ptp(evidence.log_likelihood - exact) < 1e-4
