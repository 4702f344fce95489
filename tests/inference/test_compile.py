"""Plans: what is done for each shape of net and each set of active agents."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.graph.spec import Given
from bayesnet_track.inference.compile import Draw, Fusion, Observe, compile_plan, describe_plan

GIVEN = {"sd_px": {"x": 6.0, "y": 6.0}}
NOISE = Given.model_validate(GIVEN)

FLAT = {"root": {"fuse": "product"}, "a": "root", "b": "root"}
POOLED = {"root": {"fuse": "product"}, "color": {"parent": "root", "fuse": {"pool": {"a": 3.0, "b": 1.0}}},
          "a": "color", "b": "color", "c": "root"}  # fmt: skip
NESTED = {
    "root": {"fuse": "product"},
    "body": {"parent": "root", "fuse": {"latent": {"given": GIVEN, "draw": "kernel"}}},
    "pool": {"parent": "body", "fuse": "pool"},
    "face": {"parent": "body", "fuse": {"latent": {"given": GIVEN}}},
    "a": "pool", "b": "pool", "c": "face", "d": "face", "e": "root",
}  # fmt: skip


def compiled(fakes, nodes, active):
    plate, cues = fakes.plate(nodes)
    return compile_plan(plate, active, cues)


def test_flat(fakes):
    plan = compiled(fakes, FLAT, "ab")
    assert (plan.target, plan.root, plan.active) == ("plate", "root", frozenset("ab"))
    assert plan.draws == ()
    assert plan.observations == (Observe("a", "root"), Observe("b", "root"))
    assert plan.fusions == (Fusion("root", "product", ("a", "b"), (1.0, 1.0)),)
    assert plan.fusions[0].weights("ab") == {"a": 1.0, "b": 1.0}


def test_pool_weights_sum_to_one_over_whoever_speaks(fakes):
    fusion = compiled(fakes, POOLED, "abc").fusions[0]
    assert fusion == Fusion("color", "pool", ("a", "b"), (3.0, 1.0))
    assert fusion.weights("ab") == {"a": 0.75, "b": 0.25}
    assert fusion.weights("b") == {"b": 1.0}
    assert fusion.weights("") == {}
    assert compiled(fakes, POOLED, "bc").fusions[0].weights("ab") == {"b": 1.0}


def test_a_missing_rule_of_fusion_is_a_product(fakes):
    plan = compiled(fakes, {"root": {}, "a": "root"}, "a")
    assert plan.fusions == (Fusion("root", "product", ("a",), (1.0,)),)


def test_nested_latents(fakes):
    plan = compiled(fakes, NESTED, "abcde")
    assert plan.draws == (Draw("body", "root", NOISE), Draw("face", "body", NOISE))
    assert {step.agent: step.at for step in plan.observations} == {
        "a": "body", "b": "body", "c": "face", "d": "face", "e": "root",
    }  # fmt: skip
    assert {
        fusion.node: (fusion.kind, fusion.children, fusion.given, fusion.own) for fusion in plan.fusions
    } == {
        "face": ("latent", ("c", "d"), NOISE, "grid"),
        "pool": ("pool", ("a", "b"), None, "one"),
        "body": ("latent", ("pool", "face"), NOISE, "kernel"),
        "root": ("product", ("body", "e"), None, "one"),
    }
    assert plan.fusions[-1].node == "root"


def test_branches_without_an_active_agent_vanish(fakes):
    plan = compiled(fakes, NESTED, "ae")
    assert plan.draws == (Draw("body", "root", NOISE),)
    assert [(fusion.node, fusion.children) for fusion in plan.fusions] == [
        ("pool", ("a",)), ("body", ("pool",)), ("root", ("body", "e")),
    ]  # fmt: skip
    nothing = compiled(fakes, NESTED, "")
    assert (nothing.draws, nothing.observations, nothing.fusions, nothing.planes) == ((), (), (), ())


def test_planes_of_active_agents_once_each_after_its_inputs(fakes):
    hsv = fakes.Plane("hsv")
    hue, ring = fakes.Plane("hue", (hsv,)), fakes.Plane("ring", (fakes.Plane("hue", (hsv,)),))
    plate, cues = fakes.plate({**FLAT, "c": "root"})
    cues = {
        "a": fakes.Oracle(fakes.flat(), (ring, hsv)),
        "b": fakes.Oracle(fakes.flat(), (hue,)),
        "c": fakes.Oracle(fakes.flat(), (fakes.Plane("gray"), hsv)),
    }
    plan = compile_plan(plate, "ab", cues)
    assert [str(plane) for plane in plan.planes] == ["hsv", "hue", "ring"]
    assert {agent: [str(p) for p in planes] for agent, planes in plan.idle_planes.items()} == {
        "c": ["gray", "hsv"]
    }


def test_the_plan_as_text(fakes):
    plate, cues = fakes.plate(NESTED)
    nodes = {name: plate.agent(name) for name in plate.agents}
    assert describe_plan(compile_plan(plate, "abe", cues), nodes) == "\n".join([
        "target plate",
        "  plane    a",
        "  plane    b",
        "  plane    e",
        "  draw     body given root",
        "  observe  a (a) at the hypotheses of body",
        "  observe  b (b) at the hypotheses of body",
        "  observe  e (e) at the hypotheses of root",
        "  join     pool = pool(a^0.5, b^0.5)",
        "  join     body = latent(pool) by kernel",
        "  join     root = product(body, e)",
        "  idle     c: c only for a due reference update, on the estimate's crop",
        "  idle     d: d only for a due reference update, on the estimate's crop",
    ])  # fmt: skip
    assert "(a)" not in describe_plan(compile_plan(plate, "a", cues))


@pytest.mark.parametrize(
    ("belief", "how", "said"),
    [
        (None, "grid", " on a grid"),
        ("particles", "one", ""),
        ("gaussian", "gaussian", " as a Gaussian"),
        ("grid", "grid", " on a grid"),
    ],
)
def test_the_belief_of_a_latent_node(fakes, belief, how, said):
    node = {"parent": "root", "fuse": {"latent": {"given": GIVEN}}}
    nodes = {"root": {}, "part": node if belief is None else {**node, "belief": belief}, "a": "part"}
    plan = compiled(fakes, nodes, "a")
    assert plan.fusions[0] == Fusion("part", "latent", ("a",), (1.0,), NOISE, how)
    assert f"  join     part = latent(a){said}" in describe_plan(plan).splitlines()


def test_the_belief_of_a_latent_root_is_about_the_target(fakes):
    nodes = {"root": {"belief": "gaussian", "fuse": {"latent": {"given": GIVEN}}}, "a": "root"}
    assert compiled(fakes, nodes, "a").fusions[0].own == "one"


FUSIONS = ("product", "pool", {"latent": {"given": GIVEN}}, {"latent": {"given": GIVEN, "draw": "kernel"}})


@st.composite
def trees(draw: st.DrawFn) -> tuple[dict[str, object], list[str]]:
    """Nodes of a valid tree with random fusions, and some of its agents."""
    inner = draw(st.integers(1, 6))
    nodes: dict[str, object] = {"n0": {"fuse": draw(st.sampled_from(FUSIONS[:2]))}}
    leaves = {0}
    for k in range(1, inner):
        parent = draw(st.integers(0, k - 1))
        leaves = leaves - {parent} | {k}
        nodes[f"n{k}"] = {"parent": f"n{parent}", "fuse": draw(st.sampled_from(FUSIONS))}
    parents = [*sorted(leaves), *draw(st.lists(st.integers(0, inner - 1), max_size=5))]
    agents = [f"a{k}" for k in range(len(parents))]
    nodes |= {agent: f"n{parent}" for agent, parent in zip(agents, parents, strict=True)}
    return nodes, draw(st.lists(st.sampled_from(agents), unique=True))


@given(trees())
def test_any_plan_hears_each_active_agent_once(fakes, tree):
    nodes, active = tree
    plate, cues = fakes.plate(nodes)
    plan = compile_plan(plate, active, cues)
    assert sorted(step.agent for step in plan.observations) == sorted(active)
    said = [child for fusion in plan.fusions for child in fusion.children]
    senders = {*active, *(fusion.node for fusion in plan.fusions)} - {"n0"}
    assert sorted(said) == sorted(senders)
    assert bool(plan.fusions) == bool(active)
    known = set(active)
    for fusion in plan.fusions:
        assert set(fusion.children) <= known
        assert all(plate.parent[child] == fusion.node for child in fusion.children)
        known.add(fusion.node)
    drawn = {"n0"}
    for step in plan.draws:
        assert step.given_from in drawn
        drawn.add(step.node)
    assert {step.at for step in plan.observations} <= drawn
    assert set(plan.idle_planes) == set(plate.agents) - set(active)


def test_compiling_again_gives_the_same_plan(fakes):
    plate, cues = fakes.plate(NESTED)
    first, second = (compile_plan(plate, active, cues) for active in (["a", "d", "e"], {"e", "d", "a"}))
    for name in ("active", "draws", "observations", "fusions", "planes", "idle_planes"):
        assert getattr(first, name) == getattr(second, name)


@pytest.mark.parametrize("active", ["abcde", "ae", "c", ""])
def test_recompiling_after_leaving_out_agents_only_drops_steps(fakes, active):
    whole, part = compiled(fakes, NESTED, "abcde"), compiled(fakes, NESTED, active)
    assert [o for o in whole.observations if o.agent in active] == list(part.observations)
    assert set(part.draws) <= set(whole.draws)
