"""The grid belief against the Kalman filter, and its masses, borders, resets and working points."""

import tracemalloc

import numpy as np
import pytest

from bayesnet_track import GraphSpec, Tracker
from bayesnet_track.belief.contract import Evidence, estimate
from bayesnet_track.belief.grid.belief import GridFilter
from bayesnet_track.belief.grid.motion import predict_grid
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.graph import spec
from bayesnet_track.journal.events.beliefs import BeliefReset
from bayesnet_track.journal.text.sentences import explain
from bayesnet_track.observation.cue import Measurement
from bayesnet_track.sources.scenes import make_scene

BOX = np.array([100.0, 80.0, 20.0, 10.0])
NOISE = {
    "random_walk": {"sd_px": {"x": 3.0, "y": 2.0}},
    "constant_velocity": {
        "sd_px": {"x": 1.5, "y": 1.5},
        "sd_velocity_px": 1.0,
        "start_velocity_sd_px": 1.5,
    },
    "damped_velocity": {
        "sd_px": {"x": 1.5, "y": 1.5},
        "sd_velocity_px": 1.0,
        "start_velocity_sd_px": 1.5,
        "damping": 0.25,
    },
}


def around(place, sd):
    """Evidence of a position measured at `place` with a noise of `sd` px, density at the peak 1."""

    def evaluate(hypotheses, prior_log):
        assert np.exp(prior_log).sum() == pytest.approx(1.0)
        return Evidence(-0.5 * np.sum((hypotheses.boxes[:, :2] - place) ** 2, axis=1) / sd**2)

    return evaluate


def nothing(hypotheses, prior_log):
    return Evidence(np.zeros(len(hypotheses)))


def kalman(mean, covariance, motion, dt, place, sd):
    """Prediction and update in closed form; the log of the evidence of `around`."""
    drift, noise = motion.linearise(mean, dt)
    mean, covariance = drift @ mean, drift @ covariance @ drift.T + noise
    seen = np.eye(2, len(mean))
    spread = seen @ covariance @ seen.T + sd**2 * np.eye(2)
    off = place - seen @ mean
    gain = covariance @ seen.T @ np.linalg.inv(spread)
    log = -0.5 * off @ np.linalg.solve(spread, off) - 0.5 * np.log(np.linalg.det(spread / sd**2))
    return mean + gain @ off, covariance - gain @ seen @ covariance, log


@pytest.mark.parametrize(
    ("kind", "tolerance"),
    [
        ("random_walk", 1e-10),
        ("damped_velocity", 1e-6),
        pytest.param("constant_velocity", 1e-6, marks=pytest.mark.slow),
    ],
)
def test_kalman_is_a_special_case(kind, tolerance, motion_of, stream_of):
    """Cells narrower than every sd: the sums are the integrals, but for exp(-2 pi^2 sd^2 / cell^2).

    The velocity's cells end at 5.3 sds of its first prediction, beyond which lie 1e-7 of the mass; the
    walk's cells of 1 px face sds of 2 px and more, and do not end before 7.
    """
    motion = motion_of(kind, **NOISE[kind])
    chosen = spec.Grid(cell_px=1.0, cut=0.0, window=128, velocity_cells=25, velocity_cell_px=0.8)
    belief = GridFilter(chosen)
    known = belief.start(BOX, motion, stream_of(0, 0))
    mean, covariance = motion.start_moments(BOX)
    rng = np.random.default_rng(4)
    for frame, dt in enumerate((1.0, 1.0, 2.0, 1.0), 1):
        place = BOX[:2] + rng.normal(0.0, 2.0, 2)
        stepped = belief.step(known, motion, dt, around(place, 3.0), stream_of(0, frame))
        known = stepped.posterior
        mean, covariance, log = kalman(mean, covariance, motion, dt, place, 3.0)
        np.testing.assert_allclose(known.mean, mean, rtol=0, atol=tolerance)
        np.testing.assert_allclose(known.covariance, covariance, rtol=0, atol=10 * tolerance)
        assert stepped.log_evidence == pytest.approx(log, abs=tolerance)
        assert len(known) == len(stepped.support.weights) == known.positions.size


def test_size_and_heavy_tails(motion_of, stream_of):
    """Scale noise adds up in its logarithm; the wide share of the noise in the variance of the position."""
    noise = {
        "sd_px": {"x": 2.0, "y": 2.0},
        "sd_log": {"scale": 0.08},
        "heavy_tail": {"weight": 0.2, "factor": 3.0},
    }
    motion = motion_of("random_walk", **noise)
    belief = GridFilter(spec.Grid(cell_px=1.0, cut=0.0, scale_cells=27, scale_cell=0.05))
    known = belief.start(BOX, motion, stream_of(0, 0))
    for _ in range(2):
        known = predict_grid(known, motion, 1.0, 128)
    assert known.covariance[0, 0] == pytest.approx(2 * (0.8 * 4 + 0.2 * 36), rel=1e-6)
    logs, masses = np.log(known.values[2] / BOX[2]), known.positions.sum(axis=(1, 2))
    assert masses @ logs == pytest.approx(0.0, abs=1e-9)
    assert masses @ logs**2 == pytest.approx(2 * 0.08**2, rel=1e-6)
    assert known.mean[2] / known.mean[3] == pytest.approx(2.0)
    line = known.positions.sum(axis=(0, 1))
    excess = line @ (known.values[0] - 100) ** 4 / known.covariance[0, 0] ** 2
    # One step: 3 (.8 16 + .2 1296) / 10.4^2 = 7.54; two independent ones halve the excess over 3.
    assert excess == pytest.approx(3 + (3 * (0.8 * 16 + 0.2 * 1296) / 10.4**2 - 3) / 2, rel=1e-4)


@pytest.mark.parametrize(
    ("kind", "dt", "cell", "tolerance"),
    [
        ("random_walk", 200.0, 1.0, 1e-8),
        ("constant_velocity", 12.0, 2.0, 3e-5),
        ("damped_velocity", 24.0, 2.0, 1e-6),
    ],
)
def test_a_long_gap_is_exact_while_the_window_holds_it(kind, dt, cell, tolerance, motion_of, stream_of):
    """Then a measurement, against the Kalman filter. Window and velocities end at 5 sds or more.

    A constant velocity that led to the place measured has an sd of .8 cells: 2 exp(-2 pi^2 .8^2) = 7e-6.
    """
    noise = {"sd_px": {"x": 1.5, "y": 1.5}}
    if kind != "random_walk":
        noise |= {"sd_velocity_px": 0.25, "start_velocity_sd_px": 0.5}
    motion = motion_of(kind, **noise)
    chosen = spec.Grid(cell_px=cell, cut=0.0, window=256, velocity_cells=21, velocity_cell_px=0.5)
    belief = GridFilter(chosen)
    known = belief.start(BOX, motion, stream_of(0, 0))
    mean, covariance = motion.start_moments(BOX)
    place = BOX[:2] + np.array([9.0, -14.0])
    stepped = belief.step(known, motion, dt, around(place, 6.0), stream_of(0, 1))
    mean, covariance, log = kalman(mean, covariance, motion, dt, place, 6.0)
    np.testing.assert_allclose(stepped.posterior.mean, mean, rtol=0, atol=tolerance)
    np.testing.assert_allclose(stepped.posterior.covariance, covariance, rtol=0, atol=30 * tolerance)
    assert stepped.log_evidence == pytest.approx(log, abs=tolerance)


def test_what_a_long_gap_takes_beyond_the_border_stays_there(motion_of, stream_of):
    """100 frames of a walk with an sd of 2 px, 15 px from the left border."""
    motion = Confined(motion_of("random_walk", sd_px={"x": 2.0, "y": 1.0}), 300, 200)
    known = GridFilter(spec.Grid(cell_px=1.0, window=300)).start(
        np.array([15.0, 100.0, 9, 9]), motion, stream_of(0, 0)
    )
    known = predict_grid(known, motion, 100.0, 300)
    masses = known.positions[0].sum(axis=0)
    assert known.values[0][0] == 0.0
    x = np.arange(-150.0, known.values[0][-1] + 1)
    density = np.exp(-0.5 * ((x - 15) / 20) ** 2) / (20 * np.sqrt(2 * np.pi))
    np.testing.assert_allclose(masses, [density[x <= 0].sum(), *density[x > 0]], atol=1e-9)


@pytest.mark.parametrize("dt", [7.5, 30.0, 600.0, 1e6])
def test_gaps_are_bounded(dt, motion_of, stream_of):
    """Memory of a few beliefs however long, and the target may be anywhere, but not only at the borders."""
    motion = Confined(motion_of("constant_velocity", **NOISE["constant_velocity"]), 160, 120)
    known = GridFilter(spec.Grid()).start(BOX, motion, stream_of(0, 0))
    known = predict_grid(known, motion, dt, 128)
    tracemalloc.start()
    known = predict_grid(known, motion, dt, 128)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20 * known.mass.nbytes
    assert known.mass.shape[3:] == (60, 80)
    assert known.positions[0, 1:-1, 1:-1].sum() > 0.2


@pytest.mark.parametrize("dt", [0.5, 1.0, 3.0, 200.0])
@pytest.mark.parametrize("kind", sorted(NOISE))
def test_mass_is_kept_inside_the_image(kind, dt, motion_of, stream_of):
    motion = Confined(motion_of(kind, **NOISE[kind]), 120, 90)
    known = GridFilter(spec.Grid(velocity_cells=5)).start(BOX, motion, stream_of(0, 0))
    for _ in range(4):
        known = predict_grid(known, motion, dt, 64)
        assert known.mass.sum() == pytest.approx(1.0, abs=1e-12) and known.mass.min() >= 0
        for values, size in zip(known.values[:2], (120, 90), strict=True):
            assert values[0] >= -1e-9 and values[-1] <= size - 1 + 1e-9


@pytest.mark.slow
def test_the_window_follows_a_fast_target(motion_of, stream_of):
    """20 frames at 7 px per frame, through some 4 windows of 32 px."""
    motion = Confined(motion_of("constant_velocity", **NOISE["constant_velocity"]), 640, 480)
    belief = GridFilter(spec.Grid(cell_px=1.0, window=32, velocity_cells=19, velocity_cell_px=1.0))
    known = belief.start(BOX, motion, stream_of(0, 0))
    for frame in range(1, 21):
        place = BOX[:2] + frame * np.array([7.0, 3.0])
        known = belief.step(known, motion, 1.0, around(place, 2.0), stream_of(0, frame)).posterior
        assert known.mass.shape[3] <= 32 and known.mass.shape[4] <= 32
        assert np.abs(known.mean[:2] - place).max() < 3.0 + 12.0 * (frame < 4)
    assert known.mean[4:] == pytest.approx([7.0, 3.0], abs=0.1)


@pytest.mark.parametrize("corner", [(0.0, 0.0), (319.0, 239.0), (-30.0, 400.0)])
def test_a_target_at_the_border(corner, motion_of, stream_of):
    motion = Confined(motion_of("constant_velocity", **NOISE["constant_velocity"]), 320, 240)
    belief = GridFilter(spec.Grid(velocity_cells=5, reset=spec.Reset(region="image")))
    place = np.clip(corner, 0.0, [319.0, 239.0])
    known = belief.start(np.array([*corner, 30.0, 30.0]), motion, stream_of(0, 0))
    for frame in range(1, 6):
        stepped = belief.step(known, motion, 1.0, around(place, 4.0), stream_of(0, frame))
        known = stepped.posterior
    assert not stepped.reports
    assert np.abs(known.mean[:2] - place).max() < 4.0
    boxes = known.draw(500, np.random.default_rng(0))
    assert np.abs(boxes[:, :2].mean(axis=0) - known.mean[:2]).max() < 0.5


@pytest.mark.parametrize("size", [(1.0, 1.0), (5000.0, 4000.0)])
def test_tiny_and_huge_boxes(size, motion_of, stream_of):
    motion = Confined(motion_of("random_walk", sd_box={"x": 0.2, "y": 0.2}), 320, 240)
    belief = GridFilter(spec.Grid())
    known = belief.start(np.array([100.0, 80.0, *size]), motion, stream_of(0, 0))
    for frame in range(1, 4):
        stepped = belief.step(known, motion, 1.0, around(BOX[:2], 4.0), stream_of(0, frame))
        known = stepped.posterior
        assert np.isfinite(stepped.log_evidence)
        np.testing.assert_allclose(stepped.support.boxes[:, 2:], [size] * len(known))


def test_the_cut_leaves_out_its_share(motion_of, stream_of):
    motion = motion_of("random_walk", **NOISE["random_walk"])
    known = GridFilter(spec.Grid(cell_px=1.0)).start(BOX, motion, stream_of(0, 0))
    few, all_ = (
        GridFilter(spec.Grid(cell_px=1.0, cut=cut)).step(known, motion, 1.0, nothing, stream_of(0, 1))
        for cut in (0.05, 0.0)
    )
    # 95 % of a Gaussian of sds 3 and 2 lie within 2 ln 20 of squared distance: 113 px^2, a cell each.
    assert len(few.support.weights) == pytest.approx(np.pi * 6 * 2 * np.log(20), rel=0.05)
    assert len(all_.support.weights) > 5 * len(few.support.weights)
    assert few.log_evidence == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("value", [-np.inf, np.nan, np.inf])
def test_evidence_that_cannot_be_used(value, motion_of, stream_of):
    motion = motion_of("random_walk", **NOISE["random_walk"])
    belief = GridFilter(spec.Grid(reset=spec.Reset()))
    known = belief.start(BOX, motion, stream_of(0, 0))
    stepped = belief.step(known, motion, 1.0, lambda h, p: Evidence(np.full(len(h), value)), stream_of(0, 1))
    assert stepped.degenerate and stepped.log_evidence == -np.inf
    np.testing.assert_array_equal(stepped.posterior.mass, predict_grid(known, motion, 1.0, 128).mass)
    np.testing.assert_allclose(stepped.map_state, BOX)


def test_forgetting_widens_the_prediction(motion_of, stream_of):
    """k = 2 makes an sd of 3 one of 4.24; over half a frame interval k^(1/2)."""
    motion = motion_of("random_walk", **NOISE["random_walk"])
    for dt, k in ((1.0, 2.0), (0.5, np.sqrt(2.0))):
        belief = GridFilter(spec.Grid(cell_px=1.0, cut=0.0, forget=2.0))
        known = belief.start(BOX, motion, stream_of(0, 0))
        stepped = belief.step(known, motion, dt, nothing, stream_of(0, 1))
        # The prediction ends at 7 sds, where the flattened one has 5 (k = 2): 1e-5 of its variance.
        assert stepped.posterior.covariance[0, 0] == pytest.approx(k * dt * 9.0, rel=1e-4)


@pytest.mark.parametrize("then", ["reset", "ignore"])
@pytest.mark.parametrize("region", ["belief", "image"])
def test_a_jump_is_noticed(region, then, motion_of, stream_of):
    """The target jumps 14 px (sds of 3.4 and 2.5 px) with the box as U, or right across the image."""
    motion = Confined(motion_of("random_walk", **NOISE["random_walk"]), 320, 240)
    rule = spec.Reset(region=region, then=then)
    belief = GridFilter(spec.Grid(cell_px=1.0, reset=rule))
    known = belief.start(BOX, motion, stream_of(0, 0))
    for frame in range(1, 5):
        stepped = belief.step(known, motion, 1.0, around(BOX[:2], 2.0), stream_of(0, frame))
        assert not stepped.reports
        known = stepped.posterior
    far = BOX[:2] + (np.array([14.0, 0.0]) if region == "belief" else np.array([150.0, 90.0]))
    stepped = belief.step(known, motion, 1.0, around(far, 2.0), stream_of(0, 5))
    (report,) = stepped.reports
    event = report(5, "7")
    assert isinstance(event, BeliefReset) and event.action == then and event.region == region
    assert event.gamma < event.below and (event.below == 1.0) == (region == "belief")
    assert "γ" in explain(event) and f"{event.region_px2:.0f} px²" in explain(event)
    if region == "image":
        assert event.region_px2 == 320 * 240
    if then == "ignore":
        expected = predict_grid(known, motion, 1.0, 128)
        np.testing.assert_array_equal(stepped.posterior.mass, expected.mass)
    else:
        np.testing.assert_allclose(stepped.posterior.mean[:2], far, atol=1.6)  # half of it beyond the box
    np.testing.assert_allclose(
        stepped.support.weights.weights @ stepped.support.boxes[:, :2],
        stepped.posterior.mean[:2],
        atol=1e-3,
    )


def test_gaussian_messages_about_the_velocity(motion_of, stream_of):
    """A measured velocity acts on the velocities' cells, as in the Kalman filter."""
    motion = motion_of("constant_velocity", **NOISE["constant_velocity"])
    belief = GridFilter(spec.Grid(cell_px=1.0, cut=0.0, velocity_cells=25, velocity_cell_px=0.8))
    known = belief.start(BOX, motion, stream_of(0, 0))
    seen = Measurement(("x", "vy"), np.array([102.0, 1.0]), np.array([[4.0, 0.5], [0.5, 1.0]]))

    def evaluate(hypotheses, prior_log):
        size = len(hypotheses)
        return Evidence(np.zeros(size), gaussians={"a": seen}, sampled=np.zeros(size))

    stepped = belief.step(known, motion, 1.0, evaluate, stream_of(0, 1))
    mean, covariance = motion.start_moments(BOX)
    drift, noise = motion.linearise(mean, 1.0)
    covariance = drift @ covariance @ drift.T + noise
    rows = np.zeros((2, 6))
    rows[0, 0] = rows[1, 5] = 1.0
    spread = rows @ covariance @ rows.T + seen.covariance
    off = seen.mean - rows @ mean
    gain = covariance @ rows.T @ np.linalg.inv(spread)
    np.testing.assert_allclose(stepped.posterior.mean, mean + gain @ off, atol=1e-5)
    np.testing.assert_allclose(stepped.posterior.covariance, covariance - gain @ rows @ covariance, atol=1e-4)
    ratio = np.linalg.det(spread) / np.linalg.det(seen.covariance)
    log = -0.5 * off @ np.linalg.solve(spread, off) - 0.5 * np.log(ratio)
    assert stepped.log_evidence == pytest.approx(log, abs=1e-6)


def test_three_estimates_of_a_bimodal_belief(motion_of, stream_of):
    """Two places, the likelier one further from the prediction, which is shifted to the right by nothing."""
    motion = motion_of("random_walk", sd_px={"x": 40.0, "y": 4.0})
    belief = GridFilter(spec.Grid(cell_px=1.0, window=256))
    known = belief.start(BOX, motion, stream_of(0, 0))

    def evaluate(hypotheses, prior_log):
        x = hypotheses.boxes[:, 0]
        return Evidence(np.logaddexp(-0.5 * (x - 70) ** 2 / 9, np.log(0.8) - 0.5 * (x - 115) ** 2 / 9))

    stepped = belief.step(known, motion, 1.0, evaluate, stream_of(0, 1))
    chosen = {
        kind: estimate(spec.Estimate.model_validate({kind: given}), stepped)[0]
        for kind, given in {"map": {}, "mean": {}, "nearest": {"epsilon": 0.4}}.items()
    }
    share = 0.8 * np.exp(-0.5 * 15**2 / 1609) / np.exp(-0.5 * 30**2 / 1609)
    assert share == pytest.approx(0.8 * 1.234, rel=0.01)  # posterior masses of the two: 1 and .99
    assert chosen["map"] == 70
    assert 85 < chosen["mean"] < 97
    assert 110 < chosen["nearest"] < 113
    one = estimate(spec.Estimate.model_validate({"nearest": {"epsilon": 1.0}}), stepped)
    assert one[0] == chosen["map"]


def test_regions_and_draws(motion_of, stream_of):
    motion = motion_of("random_walk", **NOISE["random_walk"])
    known = predict_grid(
        GridFilter(spec.Grid(cell_px=1.0)).start(BOX, motion, stream_of(0, 0)), motion, 1.0, 128
    )
    x_low, x_high, y_low, y_high = known.regions((0.9,))[0]
    assert [x_low, x_high] == pytest.approx([100 - 1.645 * 3, 100 + 1.645 * 3], abs=0.05)
    assert [y_low, y_high] == pytest.approx([80 - 1.645 * 2, 80 + 1.645 * 2], abs=0.05)
    boxes = known.draw(20_000, np.random.default_rng(1))
    assert boxes[:, 0].std() == pytest.approx(np.sqrt(9 + 1 / 12), rel=0.02)  # 4 sds of 1 / sqrt(2 N)
    assert len(np.unique(boxes[:, 0])) > 19_000
    assert known.uncertainty(BOX, [0, 1]) == pytest.approx(13.0, rel=1e-9)
    assert known.uncertainty(BOX + np.array([3.0, 0, 0, 0]), [0, 1]) == pytest.approx(22.0, rel=1e-9)


def test_motions_without_cells_are_refused(motion_of, stream_of):
    belief = GridFilter(spec.Grid())
    with pytest.raises(ValueError, match="ax, ay"):
        belief.start(BOX, motion_of("constant_acceleration"), stream_of(0, 0))
    with pytest.raises(ValueError, match=r"sd_log\.scale"):
        belief.start(BOX, motion_of("random_walk", sd_px={"x": 1.0, "w": 1.0}), stream_of(0, 0))


def test_a_place_measured_once_stands_for_the_frame(motion_of, stream_of):
    """An agent that finds another place among even hypotheses must not decide about the whole image by it."""
    motion = Confined(motion_of("random_walk", **NOISE["random_walk"]), 320, 240)
    belief = GridFilter(spec.Grid(cell_px=1.0, reset=spec.Reset(region="image")))
    known = belief.start(BOX, motion, stream_of(0, 0))
    asked = []

    def evaluate(hypotheses, prior_log):
        where = np.exp(prior_log) @ hypotheses.boxes[:, :2]  # it measures what it is told
        asked.append(len(hypotheses))
        seen = Measurement(("x", "y"), where, np.eye(2))
        near = -0.5 * np.sum((hypotheses.boxes[:, :2] - where) ** 2, axis=1)
        return Evidence(near, gaussians={"a": seen}, sampled=np.zeros(len(hypotheses)))

    stepped = belief.step(known, motion, 1.0, evaluate, stream_of(0, 1))
    assert len(asked) == 2 and asked[1] <= 4096
    assert not stepped.reports
    np.testing.assert_allclose(stepped.posterior.mean[:2], BOX[:2], atol=1e-3)  # the cut is uneven


def test_a_teleport_in_a_run_is_a_reset_and_an_event():
    """The picture jumps by (90, -60) px in frame 12; the pattern is found there, in the same frame."""
    scene = make_scene("gray_square", 0)
    graph = {
        "name": "jumping",
        "targets": {
            "t": {
                "nodes": {
                    "t": {
                        "belief": {"grid": {"reset": {"region": "image", "false_rate": 0.02}}},
                        "motion": {"random_walk": {"sd_px": {"x": 5, "y": 5}}},
                        "ud_fields": ["x", "y"],
                    },
                    "a": {"parent": "t", "agent": {"intensity": {"sharpness": 3, "floor": 0.001}}},
                }
            }
        },
    }
    tracker = Tracker(GraphSpec.model_validate(graph))
    tracker.init(scene.frames[0], scene.start_box)
    jump, events = np.array([90.0, -60.0]), []
    for k in range(1, 16):
        picture = scene.frames[k]
        picture = np.roll(picture, (-60, 90), axis=(0, 1)) if k >= 12 else picture
        box = np.array(tracker.update(picture)[1])
        events += tracker.events
        truth = scene.truth[k, :2] + (jump if k >= 12 else 0)
        assert np.abs(box[:2] - truth).max() < 6, k
    (event,) = (event for event in events if isinstance(event, BeliefReset))
    assert event.frame == 12 and event.gamma < event.below and event.action == "reset"
