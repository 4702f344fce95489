"""A lost target is found again by what fits as it did before, the more so the farther away it is."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from bayesnet_track.engine.scoring.score import ScoreState, Sighting, follow_fit
from bayesnet_track.graph.spec import Lost

RULE = Lost(score_below=0.25, uncertain_below=0.55, frames=3, found_fit=0.25)
HELD = Sighting(10, "1", "tracking", 0.9, 0.4, 2.0, 50.0, 50.0, 20.0)
NOTHING = replace(HELD, score=0.1, fit=0.001)


def after(*looks: Sighting) -> ScoreState:
    scored = ScoreState()
    for frame, look in enumerate(looks):
        scored, _, _ = follow_fit(scored, RULE, replace(look, frame=frame))
    return scored


def test_it_is_missing_from_the_first_of_three_bad_frames_and_not_by_two():
    assert after(*[HELD] * 6, *[NOTHING] * 2).missing is None
    assert after(*[HELD] * 6, *[NOTHING] * 3).missing == 6
    assert after(*[HELD] * 6, *[NOTHING] * 2, HELD, NOTHING).missing is None


def test_frames_that_show_nothing_at_all_and_an_unknown_usual_fit_make_nothing_missing():
    black = replace(NOTHING, surprise=0.02)
    assert after(*[HELD] * 6, *[black] * 9).missing is None
    assert after(*[HELD] * 4, *[NOTHING] * 9).missing is None


@pytest.mark.parametrize(("moved_box", "required"), [(0.0, 0.25), (1.0, 0.5), (4.0, 0.7579), (50.0, 0.7579)])
def test_what_is_found_farther_away_has_to_fit_better(moved_box, required):
    missing = after(*[HELD] * 6, *[NOTHING] * 3)
    there = replace(HELD, status="lost", x=50.0 + 20.0 * moved_box)
    _, low, none = follow_fit(missing, RULE, replace(there, fit=0.4 * (required - 0.01)))
    assert low <= 0.5 and none is None
    found, scored = None, missing
    for _ in range(3):
        assert found is None
        scored, bound, found = follow_fit(scored, RULE, replace(there, fit=0.4 * (required + 0.01)))
        assert bound == 1.0
    assert found is not None and scored.missing is None
    assert math.isclose(found.level, required, abs_tol=1e-4)
    assert (found.since, found.moved_px) == (6, 20.0 * moved_box)
    # At the largest found_fit with which it is found it is, and above that it is not.
    for found_fit, share in ((found.turning - 1e-6, 1.0), (found.turning + 1e-6, 0.5)):
        rule = RULE.model_copy(update={"found_fit": found_fit})
        _, bound, _ = follow_fit(missing, rule, replace(there, fit=0.4 * (required + 0.01)))
        assert (bound == 1.0) is (share == 1.0)


def test_a_frame_that_fits_less_well_begins_the_count_again():
    missing = after(*[HELD] * 6, *[NOTHING] * 3)
    for look in (HELD, HELD, NOTHING, HELD, HELD):
        missing, _, found = follow_fit(missing, RULE, look)
        assert found is None
    assert follow_fit(missing, RULE, HELD)[2] is not None


@pytest.mark.parametrize(("moved_box", "required"), [(0.0, 0.55), (1.0, 0.55), (4.0, 0.8612), (50.0, 0.8873)])
def test_a_poor_usual_fit_finds_nothing_far_away_that_the_score_does_not_speak_for(moved_box, required):
    missing = after(*[HELD] * 6, *[NOTHING] * 3)
    there = replace(HELD, status="lost", x=50.0 + 20.0 * moved_box)
    for _ in range(9):
        missing, bound, found = follow_fit(missing, RULE, replace(there, score=required - 0.01))
        assert found is None
    assert bound == 0.5
    # The frames that fitted count: one with a higher score is enough.
    _, bound, found = follow_fit(missing, RULE, replace(there, score=required + 0.01))
    assert found is not None and bound == 1.0
    assert math.isclose(found.score_level, required, abs_tol=1e-4)
    # The levels of the log: it is found just at this one, and not just below.
    for uncertain_below, is_found in ((found.score - 1e-6, True), (found.score + 1e-6, False)):
        rule = RULE.model_copy(
            update={"uncertain_below": uncertain_below ** (1.0 + min(max(moved_box - 1.0, 0.0), 4.0))}
        )
        assert (follow_fit(missing, rule, replace(there, score=found.score))[2] is not None) is is_found
