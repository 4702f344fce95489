"""Adaptive numbers of hypotheses in graph files: what is accepted, and each message word for word."""

from __future__ import annotations

import pytest

from bayesnet_track.graph import spec
from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.graph.text.messages import GraphError

HEAD = """bayesnet: 1
name: g
targets: {t: {nodes: {a: {parent: s, agent: motion}, s: {motion: {random_walk: {sd_px: {x: 9}}}, belief:
  {particles: """

CASES = [
    (
        "{size: 500, min: 100, max: 900}",
        "4:27: s: min beside a size of 500, which is fixed; allowed: an adaptive size (kld, kld_revised, "
        "kld_revised_simplified, asymptotic_normal, likelihood_sum), or no min\n"
        "4:37: s: max beside a size of 500, which is fixed; allowed: an adaptive size (kld, kld_revised, "
        "kld_revised_simplified, asymptotic_normal, likelihood_sum), or no max",
    ),
    (
        "{size: {kld: {bin_px: 9}}, min: 900, max: 300}",
        "4:47: s: min is 900, above max, 300; allowed: at most 300",
    ),
    (
        "{size: {kld: {bin_px: 9}}, max: 300}",
        "4:47: s: min is 500 by default, above max, 300; allowed: at least 500",
    ),
    (
        "{size: {kld: {bin_px: 9}}, min: 6000}",
        "4:47: s: min is 6000, above max, 5000 by default; allowed: at most 5000",
    ),
    (
        "{size: {kld: {bin_px: 9}}, when: {ess_below: 0.5}}",
        "4:48: s: when: ess_below beside an adaptive size, which changes by drawing new parents; "
        "allowed: when: every_frame",
    ),
    (
        "{proposal: auxiliary, when: {ess_below: 0.5}}",
        "4:43: s: when: ess_below beside proposal: auxiliary, which draws new parents; "
        "allowed: when: every_frame",
    ),
    (
        "{proposal: {second_pass: {neighbours: 3}}}",
        "4:41: s: neighbours has no effect beside by: fitted; allowed: by: parents, or no neighbours",
    ),
    (
        "{size: {asymptotic_normal: {confidence: 0.9}}}",
        "4:42: s: no error to keep; allowed: exactly one of error_px, error_sd",
    ),
    (
        "{size: {asymptotic_normal: {error_px: 1, error_sd: 0.1}}}",
        "4:42: s: asymptotic_normal with both error_px and error_sd; "
        "allowed: exactly one of error_px, error_sd",
    ),
    (
        "{size: kld_revised}",
        "4:22: s: key 'bin_px' is missing; allowed: a number above 0",
    ),
    (
        "{size: kld_revisd}",
        "4:16: s: unknown size 'kld_revisd'; allowed: kld, kld_revised, kld_revised_simplified, "
        "asymptotic_normal, likelihood_sum; nearest: kld_revised",
    ),
    (
        "{size: {kld: {bin_px: 9}, likelihood_sum: {threshold: 3}}}",
        "4:22: s: size names kld, likelihood_sum; allowed: exactly one of kld, kld_revised, "
        "kld_revised_simplified, asymptotic_normal, likelihood_sum",
    ),
    (
        "{size: {kld: {bin_px: 0, error: -1, confidence: 1, fields: [x, vx]}}, min: 50}",
        "4:37: s: bin_px is 0; allowed: a number above 0\n"
        "4:47: s: error is -1; allowed: a number above 0\n"
        "4:63: s: confidence is 1; allowed: a number at least 0.5, below 1\n"
        "4:78: s: fields[1] is 'vx'; allowed: one of x, y, w, h\n"
        "4:90: s: min is 50; allowed: a whole number at least 100, at most 1000000",
    ),
    (
        "{size: [500]}",
        "4:22: s: size is [500]; allowed: a whole number at least 2, at most 1000000 or one of kld, "
        "kld_revised, kld_revised_simplified, asymptotic_normal, likelihood_sum",
    ),
]


def parsed(particles, cues):
    node, at = read_graph(HEAD + particles + "}}}}}\n", "g.yaml")
    return check(node, at, cues)


@pytest.mark.parametrize(("particles", "said"), CASES)
def test_messages(particles, said, cues):
    with pytest.raises(GraphError) as error:
        parsed(particles, cues)
    assert [line.removeprefix("g.yaml:") for line in str(error.value).splitlines()] == said.splitlines()


def test_the_bounds_have_defaults(cues):
    node = parsed("{size: {kld_revised: {bin_px: 10}}}", cues).spec.targets["t"].nodes["s"]
    chosen = node.belief.particles
    assert (chosen.least, chosen.most) == (500, 5000)
    assert chosen.size == spec.AdaptiveSize(kld_revised=spec.BinnedSize(bin_px=10.0))
    assert chosen.size.tolerance == ("error", 0.1)


def test_equal_bounds_are_accepted(cues):
    node = (
        parsed("{size: {likelihood_sum: {threshold: 9}}, min: 301, max: 301}", cues)
        .spec.targets["t"]
        .nodes["s"]
    )
    assert (node.belief.particles.least, node.belief.particles.most) == (301, 301)
