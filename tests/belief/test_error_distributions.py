"""Errors of measurements by expressions: heavy tails, sds that depend on the state, against enumeration."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy import stats

from bayesnet_track import Start, load_graph, track
from bayesnet_track.graph.text.messages import GraphError

BOX, CENTRE = (50, 50, 20, 20), 59.5
SEEN = [61.0, 62.0, 90.0, 63.0]
LINE = np.linspace(-40.0, 160.0, 4001)
STEP = LINE[1] - LINE[0]
WALK = "motion: {random_walk: {sd_px: {x: 2, y: 2}, start_sd_px: {x: 5, y: 5}}}"
GAUSSIAN = "belief: {gaussian: {filter: extended, gate: 1}}"
PARTICLES = "belief: {particles: {size: 20000}}"


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    folder = tmp_path_factory.mktemp("images")
    for number in range(len(SEEN) + 1):
        assert cv2.imwrite(str(folder / f"{number}.png"), np.tile(np.arange(160, dtype=np.uint8), (120, 1)))
    rows = [f"{frame},{x},60" for frame, x in enumerate(SEEN, 1)]
    (folder / "radio.txt").write_text("\n".join(["frame,x,y", *rows]), encoding="utf-8")
    return folder


def graph_of(images, tmp_path, sd, root, below=""):
    text = (
        f"bayesnet: 1\nname: m\nconstants: {{heavy: 3}}\ntargets:\n  a:\n    nodes:\n      a: {{{root}, "
        "estimate: mean}\n      s: {parent: a, agent: {readings: "
        f"{{file: {images / 'radio.txt'}, sd: {sd}, floor: 1.0e-12}}}}{below}}}\n"
    )
    path = tmp_path / "m.yaml"
    path.write_text(text, encoding="utf-8")
    return load_graph(str(path))


def run(images, tmp_path, sd, root, below=""):
    graph = graph_of(images, tmp_path, sd, root, below)
    return [line.targets[0] for line in track(graph, str(images / "*.png"), [Start(BOX)], seed=1)]


def enumerated(density):
    """Mean and sd of x after each frame, on a line of 4,001 places; `density` of the errors at the places."""
    prior = stats.norm.pdf(LINE, CENTRE, 5.0)
    kernel = stats.norm.pdf(np.arange(-300, 301) * STEP, 0.0, 2.0) * STEP
    found = []
    for x in SEEN:
        prior = np.convolve(prior, kernel, "same") * density(x - LINE)
        prior = prior / (prior.sum() * STEP)
        mean = (prior * LINE).sum() * STEP
        found.append((mean, ((prior * (LINE - mean) ** 2).sum() * STEP) ** 0.5))
    return np.array(found)


ERRORS = {
    "{x: 'student_t(2, heavy)', y: 2}": lambda away: stats.t.pdf(away, 3, scale=2.0),
    "{x: laplace(3), y: 2}": lambda away: stats.laplace.pdf(away, scale=3.0),
    "{x: '1 + 0.02 * x', y: 2}": lambda away: stats.norm.pdf(away, 0.0, 1.0 + 0.02 * LINE),
    "{x: 'student_t(1 + x / 60, 4)', y: 2}": lambda away: stats.t.pdf(away, 4, scale=np.abs(1 + LINE / 60)),
}


@pytest.mark.parametrize("sd", ERRORS)
def test_particles_have_the_posterior_of_the_line(images, tmp_path, sd):
    lines = run(images, tmp_path, sd, f"{PARTICLES}, {WALK}")[1:]
    found = np.array([(line.centre_box[0], line.sd[0]) for line in lines])
    exact, count = enumerated(ERRORS[sd]), 4 if "student" in sd else 2
    # Of 20,000 draws the outlier of frame 3 leaves some hundreds, and of errors without tails none.
    assert np.abs(found - exact)[:2].max() < 0.05
    assert np.abs(found - exact)[:count].max() < 0.35


@pytest.mark.parametrize("sd", ERRORS)
def test_a_gaussian_has_the_moments_of_the_line(images, tmp_path, sd):
    lines = run(images, tmp_path, sd, f"{GAUSSIAN}, {WALK}")[1:]
    found = np.array([(line.centre_box[0], line.sd[0]) for line in lines])
    exact = enumerated(ERRORS[sd])
    # The first frame is exact; those after it begin with a Gaussian of the same moments.
    assert np.abs(found[0] - exact[0]).max() < 2e-4
    assert np.abs(found - exact).max() < 0.4


def test_an_sd_written_as_text_is_that_sd(images, tmp_path):
    as_number, as_text = (
        run(images, tmp_path, sd, f"{GAUSSIAN}, {WALK}") for sd in ("{x: 3, y: 2}", "{x: '3', y: '1 + 1'}")
    )
    for one, other in zip(as_number, as_text, strict=True):
        assert np.allclose(one.centre_box, other.centre_box, atol=1e-9)
        assert np.allclose(one.sd, other.sd, atol=1e-9)


def test_a_measurement_function_has_heavy_tails_too(images, tmp_path):
    below = ', measures: {x: "x + 0.5 * y - 30", y: y}'
    heavy, light = (
        run(images, tmp_path, sd, f"{GAUSSIAN}, {WALK}", below)[3]
        for sd in ("{x: 'student_t(2, 3)', y: 2}", "{x: 2, y: 2}")
    )
    assert heavy.centre_box[0] < 66 < 75 < light.centre_box[0]


def test_an_unknown_sd_of_a_sensor_is_learnt_by_particles(images, tmp_path):
    motion = (
        "motion: {expressions: {fields: {x: {sd: 5}, logr: {start: 1, sd: 1}}, sd: {x: 2, y: 2}, "
        "static_discount: 0.98}}"
    )
    line = run(images, tmp_path, "{x: exp(logr), y: 2}", f"belief: {{particles: {{size: 8000}}}}, {motion}")[
        -1
    ]
    levels = np.linspace(-3.0, 6.0, 181)
    log = stats.norm.logpdf(levels, 1.0, 1.0)
    for place, level in enumerate(levels):
        mean, variance = CENTRE, 25.0
        for x in SEEN:
            variance += 4.0
            spread = variance + np.exp(2 * level)
            log[place] += stats.norm.logpdf(x, mean, spread**0.5)
            mean, variance = mean + variance / spread * (x - mean), variance * (1 - variance / spread)
    shares = np.exp(log - log.max())
    exact = (shares @ levels) / shares.sum()
    assert line.state["logr"] == pytest.approx(exact, abs=0.12)


WRONG = {
    "{x: exp(r), y: 2}": "unknown name 'r'; allowed: x, y, w, h,",
    "{x: student_t(2, 3), y: 2}": "x is cut at a comma; allowed: quotes around the expression",
    "{x: 'student_t(2, 3, 4)', y: 2}": "student_t with 3 arguments; allowed: student_t(scale, degrees)",
    "{x: 'uniform(-3, 3)', y: 2}": "uniform, which is no error around 0; allowed: an sd, or one of normal",
    "{x: 'student_t(0, 3)', y: 2}": "x is 'student_t(0, 3)'; allowed: an sd, a scale and degrees above 0",
    "{x: '0', y: 2}": "x is '0'; allowed: an sd, a scale and degrees above 0",
    "{x: -2, y: 2}": "x is -2; allowed: a number above 0",
    "{x: 'x +', y: 2}": "the end where the expression goes on",
    "{x: '2 * laplace(3)', y: 2}": "laplace inside an expression; allowed: one distribution, or a value",
}


@pytest.mark.parametrize("sd", WRONG)
def test_a_wrong_error_is_refused_with_what_to_do(images, tmp_path, sd):
    with pytest.raises(GraphError) as error:
        graph_of(images, tmp_path, sd, f"{PARTICLES}, {WALK}")
    assert WRONG[sd] in str(error.value)
    assert "m.yaml:8:" in str(error.value)


def test_a_gaussian_that_could_not_learn_the_sd_is_refused(images, tmp_path):
    motion = "motion: {expressions: {fields: {logr: {sd: 1}}, sd: {x: 2, y: 2}}}"
    with pytest.raises(
        GraphError, match="learns nothing of logr, which only noise reads; allowed: belief: pa"
    ):
        graph_of(images, tmp_path, "{x: exp(logr), y: 2}", f"{GAUSSIAN}, {motion}")
    with pytest.raises(GraphError, match="an sd by an expression beside filter: kalman"):
        graph_of(
            images, tmp_path, "{x: laplace(2), y: 2}", f"belief: {{gaussian: {{filter: kalman}}}}, {WALK}"
        )
