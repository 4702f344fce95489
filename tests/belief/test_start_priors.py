"""Start priors, field by field: Gaussians against the Kalman filter's closed form, particles against it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bayesnet_track import Start, load_graph, track
from bayesnet_track.sources.entrances.notices import InputNotice

SEEN = [(61.0, 63.0), (62.5, 61.0), (66.0, 60.5), (67.5, 64.0)]
BOX = (40, 50, 20, 20)
CENTRE = 49.5
Q, R = 1.5, 2.0


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    folder = tmp_path_factory.mktemp("images")
    for number in range(len(SEEN) + 1):
        assert cv2.imwrite(str(folder / f"{number}.png"), np.tile(np.arange(160, dtype=np.uint8), (120, 1)))
    rows = [f"{frame},{x},{y}" for frame, (x, y) in enumerate(SEEN, 1)]
    (folder / "radio.txt").write_text("\n".join(["frame,x,y", *rows]), encoding="utf-8")
    return folder


def run(images, tmp_path, root, *, seed=1):
    text = (
        "bayesnet: 1\nname: m\nconstants: {focal: 300}\ntargets:\n  a:\n    nodes:\n"
        f"      a: {{{root}, estimate: mean}}\n      s: {{parent: a, agent: {{readings: "
        f"{{file: {images / 'radio.txt'}, sd: {{x: {R}, y: {R}}}, floor: 1.0e-9}}}}}}\n"
    )
    path = tmp_path / "m.yaml"
    path.write_text(text, encoding="utf-8")
    lines = list(track(load_graph(str(path)), str(images / "*.png"), [Start(BOX)], seed=seed))
    return [line.targets[0] for line in lines]


def kalman(mean, variance, drift=0.0):
    """Mean and sd of x in each frame: a walk with known drift, by the closed form."""
    found = [(mean, variance**0.5)]
    for x, _ in SEEN:
        mean, variance = mean + drift, variance + Q**2
        gain = variance / (variance + R**2)
        mean, variance = mean + gain * (x - mean), (1 - gain) * variance
        found.append((mean, variance**0.5))
    return np.array(found)


WALKS = {
    "sd of a walk": ("motion: {random_walk: {sd_px: {x: 1.5, y: 1.5}, start_sd_px: {x: 12}}}", 0.0),
    "sd of a field": ("motion: {expressions: {fields: {x: {sd: 12}}, sd: {x: 1.5, y: 1.5}}}", 0.0),
    "distribution": (
        'motion: {random_walk: {sd_px: {x: 1.5, y: 1.5}}}, start: {x: "normal(x + 9, 12)"}',
        9.0,
    ),
}
GAUSSIAN = "belief: {gaussian: {filter: extended, gate: 1}}"


@pytest.mark.parametrize("name", WALKS)
def test_a_gaussian_starts_as_the_closed_form(images, tmp_path, name):
    motion, away = WALKS[name]
    lines = run(images, tmp_path, f"{GAUSSIAN}, {motion}")
    exact = kalman(CENTRE + away, 12.0**2)
    found = [(line.centre_box[0], line.sd[0]) for line in lines]
    assert np.allclose(found, exact, atol=1e-9)


@pytest.mark.parametrize("name", WALKS)
def test_particles_start_as_the_closed_form(images, tmp_path, name):
    motion, away = WALKS[name]
    lines = run(images, tmp_path, f"belief: {{particles: {{size: 20000}}}}, {motion}")
    exact = kalman(CENTRE + away, 12.0**2)
    found = np.array([(line.centre_box[0], line.sd[0]) for line in lines])
    # Of 20,000 draws the mean is off by less than 4 sds of it, resampled in each of four frames.
    assert np.abs(found - exact).max() < 4 * 2 * exact[1:, 1].max() / np.sqrt(20000) + 4 * 12 / 20000**0.5


def test_a_density_is_drawn_as_written_and_kept_as_its_moments(images, tmp_path):
    root = 'motion: {random_walk: {sd_px: {x: 1.5, y: 1.5}}}, start: {x: "uniform(x - 6, x + 30)"}'
    first = [run(images, tmp_path, f"{belief}, {root}")[0] for belief in (GAUSSIAN, "belief: {particles: "
             "{size: 20000}}")]  # fmt: skip
    for line in first:
        assert line.centre_box[0] == pytest.approx(CENTRE + 12)
        assert line.sd[0] == pytest.approx(36 / 12**0.5, rel=0.02)
    assert first[1].region90[:2] == pytest.approx((CENTRE - 6 + 1.8, CENTRE + 30 - 1.8), abs=0.5)


def test_a_known_first_velocity_needs_no_motion_of_ones_own(images, tmp_path):
    root = "motion: {constant_velocity: {sd_velocity_px: 0, sd_px: {x: 1.5, y: 1.5}}}, start: {vx: 4, vy: 0}"
    lines = run(images, tmp_path, f"{GAUSSIAN}, {root}")
    found = [(line.centre_box[0], line.sd[0]) for line in lines]
    assert np.allclose(found, kalman(CENTRE, 0.0, drift=4.0), atol=1e-9)


def test_a_field_starts_by_the_start_box(images, tmp_path):
    motion = "motion: {expressions: {fields: {depth: {}}, sd: {x: 1.5, y: 1.5, depth: 0.1}}}"
    root = f'{motion}, start: {{depth: "lognormal(log(1.7 * focal / h), 0.1)"}}'
    for belief in (GAUSSIAN, "belief: {particles: {size: 5000}}"):
        line = run(images, tmp_path, f"{belief}, {root}")[1]
        assert line.state["depth"] == pytest.approx(1.7 * 300 / 20 * np.exp(0.005), rel=0.01)
        assert line.state["depth_sd"] == pytest.approx(2.56, rel=0.2)  # few draws reach the first reading


def test_modes_start_alike(images, tmp_path):
    motion = (
        "motion: {random_walk: {sd_px: {x: 1.5, y: 1.5}, start_sd_px: {x: 12}}}, modes: {still: "
        "{mean_frames: 50}, fast: {mean_frames: 50, motion: {random_walk: {sd_px: {x: 1.5, y: 3}}}}}"
    )
    lines = run(images, tmp_path, f"{GAUSSIAN}, {motion}")
    assert lines[0].sd[0] == pytest.approx(12.0)
    assert np.allclose([line.sd[0] for line in lines], kalman(CENTRE, 144.0)[:, 1], atol=1e-6)


def test_a_prior_without_a_value_in_the_start_box_is_said(images, tmp_path):
    motion = "motion: {random_walk: {sd_px: {x: 1.5, y: 1.5}}}"
    with pytest.warns(InputNotice, match="start of x has no value in the start box x 49.5, y 59.5, w 20"):
        lines = run(images, tmp_path, f'{GAUSSIAN}, {motion}, start: {{x: "normal(x, sqrt(w - 40))"}}')
    assert lines[0].sd[0] == 0.0


def test_a_constant_may_start_with_any_density(images, tmp_path):
    motion = (
        "motion: {expressions: {fields: {q: {}}, sd: {x: q, y: q}, static_discount: 0.98}}, "
        'start: {q: "uniform(0.5, 6)"}'
    )
    line = run(images, tmp_path, f"belief: {{particles: {{size: 4000}}}}, {motion}")[-1]
    assert 0.8 < line.state["q"] < 6 and line.state["q_sd"] > 0.3
