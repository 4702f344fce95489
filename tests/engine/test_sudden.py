"""A target that leaps out of its hypotheses' reach is found in the same frame, where it fits as usual."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.engine.second_steps import CELL_BOX
from bayesnet_track.engine.step import step
from bayesnet_track.journal.events.beliefs import Reappeared
from bayesnet_track.observation.planes import Frame

BOX = (40.0, 50.0, 10.0, 10.0)
SUDDEN = {"below_fit": 0.2, "reach_box": 3.0}


def nodes_of(sudden, **settings):
    walk = {"sd_px": {"x": 2.0, "y": 2.0}, "relocalize": {"grow_box": 0.25, "sudden": sudden}}
    return {
        "root": {
            "motion": {"random_walk": walk | settings},
            "belief": {"particles": {"size": 200}},
            "score": {"logistic": {"bias": 4.0, "log_fit": 1.0}},
            "lost": {"score_below": 0.25, "uncertain_below": 0.55, "frames": 3, "found_fit": 0.25},
        },
        "eye": "root",
    }


def scene(index, pan=0):
    """A frame of a textured picture, rolled by `pan` px."""
    cells = np.random.default_rng(2).integers(0, 256, (25, 30, 1), dtype=np.uint8)
    image = np.roll(np.kron(cells, np.ones((4, 4, 3), np.uint8)), pan, axis=1)
    return Frame(index, float(index), np.ascontiguousarray(image))


@pytest.fixture
def leap(fakes):
    """Track 8 frames at rest, then at where a target with this fit leaps to: the estimates and events."""

    def run(sudden, way, fit=1.0, pan=0, **settings):
        place = {"x": BOX[0], "fit": 1.0}

        def see(planes, hypotheses, reference):
            away = (hypotheses.boxes[:, :2] - [place["x"], BOX[1]]) / 1.5
            return np.logaddexp(np.log(place["fit"]) - 0.5 * np.sum(away**2, axis=1), np.log(1e-4))

        engine = fakes.engine(nodes_of(sudden, **settings), {"eye": see})[0]
        outcomes = fakes.play(engine, [scene(index) for index in range(9)], {"1": BOX})
        place["x"], place["fit"] = BOX[0] + way, fit
        start = len(outcomes)
        for index in range(start, start + 2):
            outcomes.append(step(engine, outcomes[-1].state, scene(index, pan)))
        after = outcomes[start:]
        told = [event for one in after for event in one.events if isinstance(event, Reappeared)]
        run.lines = [one.metrics[0] for one in outcomes[start - 1 :]]
        return [one.metrics[0].centre_box[0] for one in after], told

    return run


def test_it_is_found_at_once_and_that_is_told_with_its_reason(leap):
    (x, _), (told,) = leap(SUDDEN, 22.0)
    assert abs(x - 62.0) < 1.5
    assert told.fit < told.below_fit == 0.2
    assert told.within_px == pytest.approx(30.0, rel=0.1)
    assert "of the usual one; " in told.describe()


def test_the_score_does_not_go_by_a_belief_that_is_as_wide_as_the_search(leap):
    leap(SUDDEN, 22.0)
    before, found, after = leap.lines
    own = [np.log(one.ud_px2 / (one.centre_box[2] * one.centre_box[3])) for one in leap.lines]
    assert own[1] > own[0] + 1.0
    assert found.features["log_ud_box"] == before.features["log_ud_box"]
    assert after.features["log_ud_box"] != found.features["log_ud_box"]
    leap(None, 22.0)
    before, found, _ = leap.lines
    assert found.features["log_ud_box"] != before.features["log_ud_box"]


@pytest.mark.parametrize(
    ("sudden", "way", "fit"),
    [(None, 22.0, 1.0), (SUDDEN, 45.0, 1.0), (SUDDEN, 22.0, 0.1)],
    ids=["without", "beyond the square", "what fits too little"],
)
def test_else_the_frame_is_as_without_the_search(leap, sudden, way, fit):
    places, told = leap(sudden, way, fit)
    assert told == []
    assert places == leap(None, way, fit)[0]


def test_it_is_searched_only_where_the_picture_pans_if_so_asked(leap):
    pans = {**SUDDEN, "pan_box": 0.5}
    assert leap(pans, 22.0, pan=8)[1] != []
    for pan in (0, 3):
        places, told = leap(pans, 22.0, pan=pan)
        assert told == [] and places == leap(None, 22.0)[0]


def test_nothing_is_searched_while_something_fits(leap):
    """A move within reach leaves the draws as they are."""
    assert leap(SUDDEN, 1.0) == leap(None, 1.0)


def test_cells_are_no_larger_than_what_a_precise_agent_answers_to(leap):
    """Evenly spread hypotheses would mostly miss a target that is seen within a fifth of its side."""
    assert CELL_BOX * BOX[2] <= 2.0
    assert leap({**SUDDEN, "reach_box": 5.0}, -35.0)[1]
