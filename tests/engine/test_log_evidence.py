"""`log_evidence` of agents that measure is a density: against the Kalman filter's closed form."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy import stats

from bayesnet_track import Start, load_graph, track
from bayesnet_track.cli.main import main

FRAMES, Q, R = 25, 2.0, 4.0
RNG = np.random.default_rng(1)
PLACES = 80 + np.cumsum(RNG.normal(0, Q, FRAMES + 1))
SEEN = np.round(PLACES + RNG.normal(0, R, FRAMES + 1), 6)
GAUSSIAN = "belief: {gaussian: {filter: extended, gate: 1}}"
PARTICLES = "belief: {particles: {size: 4000}}"


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    folder = tmp_path_factory.mktemp("images")
    for number in range(FRAMES + 1):
        name = str(folder / f"{number:02}.png")
        assert cv2.imwrite(name, np.tile(np.arange(160, dtype=np.uint8), (120, 1)))
    rows = "".join(f"{frame},{SEEN[frame]},{2 * SEEN[frame]}\n" for frame in range(1, FRAMES + 1))
    (folder / "seen.txt").write_text("frame,x,u\n" + rows, encoding="utf-8")
    return folder


def write(images, tmp_path, belief, sd, *, walk=Q, more="", name="m"):
    sensor = f"{{readings: {{file: {images / 'seen.txt'}, sd: {sd}, floor: 1.0e-9}}}}"
    text = (
        f"bayesnet: 1\nname: m\ntargets:\n  a:\n    nodes:\n      a: {{{belief}, motion: {{random_walk: "
        f"{{sd_px: {{x: {walk}, y: 0.1}}}}}}, estimate: mean, fuse: product}}\n"
        f"      s: {{parent: a, agent: {sensor}{more}}}\n"
    )
    path = tmp_path / f"{name}.yaml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def run(images, path):
    lines = track(load_graph(path), str(images / "*.png"), [Start((70, 50, 20, 20))], seed=1)
    return [line.targets[0] for line in lines]


def exact(sd, walk=Q, scale=1.0):
    """log p(z_1, ..., z_T) of z = scale x + N(0, sd^2), by the closed form."""
    mean, variance, total = 79.5, 0.0, 0.0
    for z in scale * SEEN[1:]:
        variance += walk**2
        spread = scale**2 * variance + sd**2
        total += float(stats.norm.logpdf(z, scale * mean, spread**0.5))
        gain = scale * variance / spread
        mean, variance = mean + gain * (z - scale * mean), variance * (1 - gain * scale)
    return total


@pytest.mark.parametrize("sd", [2.0, 4.0, 64.0])
def test_a_gaussians_evidence_is_the_closed_form(images, tmp_path, sd):
    lines = run(images, write(images, tmp_path, GAUSSIAN, f"{{x: {sd}}}"))
    assert sum(line.log_evidence for line in lines) == pytest.approx(exact(sd), abs=1e-6)
    assert sum(line.log_predictive.get("s", 0.0) for line in lines) == pytest.approx(exact(sd), abs=1e-6)


def test_the_true_error_is_preferred_to_a_vaguer_one(images, tmp_path):
    totals = {
        sd: sum(line.log_evidence for line in run(images, write(images, tmp_path, GAUSSIAN, f"{{x: {sd}}}")))
        for sd in (1.0, 4.0, 64.0)
    }
    assert totals[4.0] > totals[64.0] + 10 and totals[4.0] > totals[1.0] + 10


def test_particles_estimate_the_same_density(images, tmp_path):
    lines = run(images, write(images, tmp_path, PARTICLES, "{x: 4}"))
    # 25 frames, each of the mean of 4,000 likelihoods whose own sd is about their mean.
    assert sum(line.log_evidence for line in lines) == pytest.approx(
        exact(4.0), abs=4 * (25 / 4000) ** 0.5 * 2
    )


def test_a_measured_function_brings_its_own_unit(images, tmp_path):
    more = ", measures: {u: 2 * x}"
    lines = run(images, write(images, tmp_path, GAUSSIAN, "{u: 8}", more=more))
    assert sum(line.log_evidence for line in lines) == pytest.approx(exact(8.0, scale=2.0), abs=1e-6)
    # In another unit the density is another one, by the Jacobian.
    assert exact(8.0, scale=2.0) == pytest.approx(exact(4.0) - FRAMES * np.log(2.0), abs=1e-6)


def test_an_error_with_heavy_tails_has_its_density(images, tmp_path):
    as_text, as_number = (
        sum(one.log_evidence for one in run(images, write(images, tmp_path, GAUSSIAN, sd)))
        for sd in ('{x: "2 + 2"}', "{x: 4}")
    )
    assert as_text == pytest.approx(as_number, abs=1e-6)
    heavy = run(images, write(images, tmp_path, GAUSSIAN, '{x: "student_t(4, 1.0e+7)"}'))
    assert sum(one.log_evidence for one in heavy) == pytest.approx(as_number, abs=1e-3)
    assert sum(one.log_predictive.get("s", 0.0) for one in heavy) == pytest.approx(as_number, abs=1e-3)


def test_what_is_gated_out_costs_what_an_outlier_costs(images, tmp_path):
    """Else the model that gates most would have the largest evidence."""
    narrow = "belief: {gaussian: {filter: extended, gate: 0.5}}"
    gated = write(images, tmp_path, narrow, "{x: 0.5}", walk=0.5, name="g")
    used = write(images, tmp_path, GAUSSIAN, "{x: 4}")
    first, second = (sum(line.log_evidence for line in run(images, path)) for path in (gated, used))
    assert first < second - 50


def test_a_pool_weighs_the_constants(images, tmp_path):
    path = write(images, tmp_path, GAUSSIAN, "{x: 4}", more=", temperature: 2")
    tempered = sum(line.log_evidence for line in run(images, path))
    vague = exact(4.0 * 2**0.5)  # the variance is doubled, and half of the constant is left
    constant = FRAMES * 0.5 * np.log(2 * np.pi)
    assert tempered == pytest.approx(
        vague + FRAMES * np.log(4 * 2**0.5) + constant - 0.5 * (FRAMES * np.log(4) + constant), abs=1e-6
    )


def test_agents_that_score_keep_a_likelihood_of_at_most_1(images, tmp_path):
    path = write(images, tmp_path, PARTICLES, "{x: 4}")
    text = (tmp_path / "m.yaml").read_text(encoding="utf-8").split("      s: ")[0]
    (tmp_path / "m.yaml").write_text(text + "      s: {parent: a, agent: intensity}\n", encoding="utf-8")
    lines = run(images, path)
    assert all(line.log_evidence <= 1e-12 and not line.log_predictive for line in lines)


def test_compare_shows_evidence_and_predictions_of_the_common_sensor(images, tmp_path, capsys):
    for name, sd in (("one", 4.0), ("two", 64.0)):
        path = write(images, tmp_path, GAUSSIAN, f"{{x: {sd}}}", name=name)
        options = ["--source", str(images / "*.png"), "--init", "70,50,20,20", "-q"]
        assert main(["run", path, *options, "--out", str(tmp_path / f"run-{name}")]) == 0
    capsys.readouterr()
    assert main(["compare", str(tmp_path / "run-one"), str(tmp_path / "run-two")]) == 0
    table = [line for line in capsys.readouterr().out.splitlines() if "nats" in line]
    assert [line.split("  ")[0].strip() for line in table] == [
        "log-evidence, nats (25 of 25 frames)", "predictive log density of s, nats (25 frames)"]  # fmt: skip
    shown = f"{-exact(4.0):.1f}"
    assert all(f"−{shown}" in line for line in table)
