"""How a grid starts, and what a reset leaves: exact values of every part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from bayesnet_track.belief.contract import Evidence
from bayesnet_track.belief.grid.belief import GridFilter, judge_on_image
from bayesnet_track.belief.grid.cells import GridBelief, GridLimits, Lattice
from bayesnet_track.belief.grid.motion import predict_grid
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.graph import spec
from bayesnet_track.numerics.distributions import spreading_matrix

BOX = np.array([50.0, 40.0, 20.0, 10.0])
NOISE = {"sd_px": {"x": 1.0, "y": 1.0}, "sd_log": {"scale": 0.1}, "sd_velocity_px": 0.7}


@dataclass(frozen=True)
class Uneven:
    """A motion whose first velocity is known better along than across; the rest is that of `model`."""

    model: object
    sds: tuple[float, float]

    def __getattr__(self, name):
        return getattr(self.model, name)

    @property
    def fields(self):
        return ("x", "y", "w", "h", "vx", "vy")

    def start_moments(self, box):
        return np.array([*box, 0.0, 0.0]), np.diag([0.0, 0.0, 0.0, 0.0, *np.square(self.sds)])


def test_each_axis_of_the_first_velocity_has_its_own_sd(motion_of, stream_of):
    motion = Uneven(motion_of("constant_velocity", **NOISE), (0.5, 2.0))
    chosen = GridFilter(spec.Grid(velocity_cells=5, velocity_cell_px=0.5, scale_cells=3, scale_cell=0.2))
    start = chosen.start(BOX, motion, stream_of(0, 0))
    vx, vy = (spreading_matrix(5, 1.0, sd / 0.5)[:, 2] for sd in (0.5, 2.0))
    expected = np.outer(vy / vy.sum(), vx / vx.sum())
    assert expected[0, 2] > 2 * expected[2, 0]
    np.testing.assert_allclose(start.first_velocities, expected, rtol=1e-12)
    np.testing.assert_allclose(start.mass[..., 0, 0].sum(axis=0), expected, rtol=1e-12)
    assert start.lattice.anchor == (50.0, 40.0) and start.lattice.size == (20.0, 10.0)
    assert (start.lattice.column, start.lattice.row) == (0, 0)


def test_a_start_without_noise_of_the_size_has_one_scale(motion_of, stream_of):
    motion = motion_of("random_walk", sd_px={"x": 3.0, "y": 2.0})
    start = GridFilter(spec.Grid(cell_px=3.0, scale_cells=5)).start(BOX, motion, stream_of(0, 0))
    assert start.mass.shape == (1, 1, 1, 1, 1) and start.mass.sum() == 1.0
    assert start.lattice.log_scales.tolist() == [0.0] and start.lattice.velocities.tolist() == [0.0]
    assert start.lattice.cell_px == 3.0


def test_a_start_inside_the_image_stays_where_it_is(motion_of, stream_of):
    walk = motion_of("random_walk", sd_px={"x": 3.0, "y": 2.0})
    chosen = GridFilter(spec.Grid())
    for place, kept in (((0.5, 0.25), (0.5, 0.25)), ((-1.0, 30.0), (0.0, 29.0)), ((99.0, 29.0),) * 2):
        box = np.array([*place, 20.0, 10.0])
        assert chosen.start(box, Confined(walk, 100, 30), stream_of(0, 0)).lattice.anchor == kept


def test_fields_that_have_no_cells_are_named(motion_of, stream_of):
    with pytest.raises(ValueError, match=r"not for x, y, w, h, vx, vy, ax, ay$"):
        GridFilter(spec.Grid()).start(BOX, motion_of("constant_acceleration"), stream_of(0, 0))


def at(place, sd=2.0, scale=0.0):
    def evaluate(hypotheses, prior_log):
        return Evidence(scale - 0.5 * ((hypotheses.boxes[:, :2] - place) ** 2).sum(axis=1) / sd**2)

    return evaluate


def step_after_a_leap(region, far, motion, stream_of):
    chosen = GridFilter(
        spec.Grid(cell_px=1.0, window=32, cut=0.0, reset=spec.Reset(region=region, then="reset"))
    )
    known = chosen.start(BOX, motion, stream_of(0, 0))
    return predict_grid(known, motion, 1.0, 32), chosen.step(
        known, motion, 1.0, at(far, 1.0), stream_of(0, 1)
    )


def test_a_reset_over_the_belief_is_the_likelihood_over_its_box(motion_of, stream_of):
    motion = Confined(motion_of("random_walk", sd_px={"x": 1.0, "y": 1.0}), 200, 100)
    far = BOX[:2] + np.array([6.0, 0.0])
    moved, stepped = step_after_a_leap("belief", far, motion, stream_of)
    assert len(stepped.reports) == 1
    likelihood = np.exp(at(far, 1.0)(stepped.support, None).log_likelihood)
    assert len(likelihood) == moved.positions.size
    found = stepped.posterior.positions.ravel()
    np.testing.assert_allclose(found, likelihood / likelihood.sum(), atol=1e-12)
    assert stepped.log_evidence == pytest.approx(np.log(likelihood.mean()))
    np.testing.assert_allclose(stepped.support.weights.weights, found, atol=1e-12)
    np.testing.assert_allclose(np.exp(stepped.prior.log), 1.0 / len(found), rtol=1e-9)
    assert stepped.degenerate is None


def test_a_reset_over_the_image_is_the_likelihood_around_its_peak(motion_of, stream_of):
    motion = Confined(motion_of("random_walk", sd_px={"x": 1.0, "y": 1.0}), 200, 100)
    far = np.array([120.0, 60.0])
    _, stepped = step_after_a_leap("image", far, motion, stream_of)
    (report,) = stepped.reports
    boxes = stepped.support.boxes
    assert len(boxes) == 32 * 32 and np.ptp(boxes[:, 0]) == 31 == np.ptp(boxes[:, 1])
    likelihood = np.exp(-0.5 * ((boxes[:, :2] - far) ** 2).sum(axis=1))
    np.testing.assert_allclose(stepped.posterior.positions.ravel(), likelihood / likelihood.sum(), atol=1e-9)
    # 2 pi px^2 lie under the peak; the image is judged at every third place of 20,000.
    assert stepped.log_evidence == pytest.approx(np.log(2 * np.pi / 20000), abs=0.6)
    assert report(1, "1").region_px2 == 20000


# ------------------------------------------------------------------------------------ the image, coarsely


def coarse(rule, place, limits, log_evidence, mass=None, spoil=None):
    """The verdict, and the places at which it was taken."""
    lattice = Lattice((0.0, 0.0), 1.0, 0, 0, (20.0, 10.0), np.zeros(1), np.zeros(1))
    belief = GridBelief(np.ones((1, 1, 1, 1, 1)) if mass is None else mass, lattice, np.ones((1, 1)))
    asked = []

    def ask(states):
        asked.append(states)
        found = at(place, 9.0)(SeenBoxes(states), None)
        return found if spoil is None else spoil(found)

    return judge_on_image(rule, belief, limits, log_evidence, ask), asked


@dataclass(frozen=True)
class SeenBoxes:
    boxes: np.ndarray


BELOW = spec.Reset(region="image", below=1.0)
WIDE = GridLimits((0, 199), (0, 99), 32)


def test_a_large_image_is_judged_at_every_third_place_from_its_middle():
    """20,000 cells at most 4,096 places: a stride of 3; 199 = 66 * 3 + 1 and 99 = 33 * 3."""
    verdict, (states,) = coarse(BELOW, np.array([60.0, 30.0]), WIDE, -9.0)
    assert len(states) == 67 * 34 <= 4096
    assert sorted(set(states[:, 0])) == list(range(0, 200, 3))
    assert sorted(set(states[:, 1])) == list(range(0, 100, 3))
    assert verdict.report(1, "1").region_px2 == 20000
    _, (states,) = coarse(BELOW, np.array([60.0, 30.0]), GridLimits((0, 198), (0, 99), 32), -9.0)
    assert max(states[:, 0]) == 198 and max(states[:, 1]) == 99  # the last ones belong to the image
    _, (states,) = coarse(BELOW, np.array([60.0, 30.0]), GridLimits((0, 200), (1, 99), 32), -9.0)
    assert min(states[:, 0]) == 1 and max(states[:, 0]) == 199  # 200 = 66 * 3 + 2: one left out on each side
    assert min(states[:, 1]) == 2 and max(states[:, 1]) == 98


@pytest.mark.parametrize(
    ("limits", "spoil"),
    [
        (GridLimits(None, (0, 99), 32), None),
        (GridLimits((0, 199), None, 32), None),
        (WIDE, lambda found: Evidence(found.log_likelihood, faults={"a": "broken"})),
        (WIDE, lambda found: Evidence(np.full(len(found.log_likelihood), -np.inf))),
    ],
)
def test_without_borders_or_evidence_nothing_is_judged(limits, spoil):
    verdict, _ = coarse(BELOW, np.zeros(2), limits, -700.0, spoil=spoil)
    assert verdict.report is None and verdict.mean == -np.inf and verdict.peak is None


def test_the_level_of_a_false_reset_is_that_of_the_mass_at_the_nearest_places():
    """A belief on the peak has a higher level than one spread over the image, which explains all evidence."""
    rule = spec.Reset(region="image", false_rate=0.01)
    place = np.array([60.0, 30.0])
    narrow = np.zeros((1, 1, 1, 100, 200))
    narrow[..., 29:32, 59:62] = 1 / 9
    levels = []
    for mass in (narrow, np.full(narrow.shape, 1 / 20000)):
        verdict, _ = coarse(rule, place, WIDE, -800.0, mass)
        event = verdict.report(1, "1")
        assert event.gamma == pytest.approx(0.0, abs=1e-200)
        levels.append(event.below)
    # gamma is |U| / (2 pi 81) in the middle, and 1 % of it at the 1 % quantile; cells are 3 px wide.
    assert levels[0] == pytest.approx(20000 / (2 * np.pi * 81) * 0.01, rel=0.3)
    assert levels[1] < 1.05
