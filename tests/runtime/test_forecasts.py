"""`horizon` writes what `Tracker.predict` says, changes nothing else, and goes on where a run is resumed."""

import json

import numpy as np
import pytest

from bayesnet_track import Start, Tracker, track
from bayesnet_track.runtime.checkpoints.resume import resume
from bayesnet_track.runtime.checkpoints.standing import verify
from bayesnet_track.sources.scenes.library import SceneSource

FRAMES, HORIZON = 8, 3


def tracked(out, stop=None, **options):
    source = SceneSource.named("flying_ball", 0, FRAMES)
    results = track("kalman_ball", source, [Start(source.scene.start_box)], out=out, **options)
    for n, _ in enumerate(results, start=1):
        if n == stop:
            results.close()
            break
    return out


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return tracked(tmp_path_factory.mktemp("ahead") / "run", horizon=HORIZON)


def test_the_file_has_what_the_tracker_predicts(run):
    lines = [json.loads(line) for line in (run / "forecasts.jsonl").read_text().splitlines()]
    assert len(lines) == FRAMES * HORIZON
    source = SceneSource.named("flying_ball", 0, FRAMES)
    tracker, found = Tracker("kalman_ball"), []
    for n, frame in enumerate(source):
        if n == 0:
            tracker.init(frame.image, source.scene.start_box)
        else:
            tracker.update(frame.image)
        found += [(n, one) for one in tracker.predict(HORIZON)]
    for line, (frame, one) in zip(lines, found, strict=True):
        assert (line["frame"], line["target"], line["ahead"]) == (frame, one.target, one.ahead)
        for key, values in (("box", one.centre_box), ("sd", one.sd), ("region90", one.region90)):
            np.testing.assert_allclose(line[key], values, atol=6e-4)


def test_nothing_else_changes_and_the_run_is_verified(run, tmp_path):
    plain = tracked(tmp_path / "run")
    assert (plain / "frames.npy.gz").read_bytes() == (run / "frames.npy.gz").read_bytes()
    assert verify(run).status == "verified" and not (plain / "forecasts.jsonl").exists()


def test_forecasts_go_on_where_a_run_is_resumed(run, tmp_path):
    tracked(tmp_path / "run", stop=4, horizon=HORIZON)
    list(resume(tmp_path / "run"))
    assert (tmp_path / "run/forecasts.jsonl").read_bytes() == (run / "forecasts.jsonl").read_bytes()


def test_a_horizon_below_0_is_refused():
    with pytest.raises(ValueError, match="horizon=-1: a whole number from 0 on is needed"):
        tracked(None, horizon=-1)
