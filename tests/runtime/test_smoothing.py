"""A smoothed run is a run: surer than the filter's, readable by every command, the same bytes again."""

import shutil

import numpy as np
import pytest

from bayesnet_track import Start, open_run, track
from bayesnet_track.belief.smoothing import Move, smooth_gaussians
from bayesnet_track.engine.compiled import make_plate_motion
from bayesnet_track.runtime.checkpoints.resume import resume
from bayesnet_track.runtime.checkpoints.standing import verify
from bayesnet_track.runtime.recording.beliefs import read_beliefs
from bayesnet_track.runtime.recording.manifest import write_smoothed
from bayesnet_track.runtime.recording.rundir import RunDirectoryError
from bayesnet_track.runtime.smoothing import KeptBeliefsError, _root_of, motion_into, smooth
from bayesnet_track.sources.scenes.library import SceneSource

FRAMES = 12


def tracked(graph, scene, out, frames=FRAMES, stop=None, **options):
    source = SceneSource.named(scene, 0, frames)
    results = track(graph, source, [Start(source.scene.start_box)], out=out, **options)
    for n, _ in enumerate(results, start=1):
        if n == stop:
            results.close()
            break
    return open_run(out)


@pytest.fixture(scope="module")
def particle_run(tmp_path_factory):
    return tracked("two_squares", "two_squares", tmp_path_factory.mktemp("kept") / "run", keep_beliefs=True)


@pytest.fixture(scope="module")
def gaussian_run(tmp_path_factory):
    return tracked("kalman_ball", "flying_ball", tmp_path_factory.mktemp("kept") / "run", keep_beliefs=True)


@pytest.fixture(scope="module")
def modal_run(tmp_path_factory):
    out = tmp_path_factory.mktemp("kept") / "run"
    return tracked("hidden_ball", "flying_ball", out, 36, keep_beliefs=True)


def test_modes_are_given_the_whole_run(modal_run):
    """Behind the pillar from frame 19 to 31, and nearest to its middle half-way."""
    filtered, lines = modal_run.metrics, smooth(modal_run).metrics
    middle = [(line.sd[0], before.sd[0]) for line, before in zip(lines, filtered, strict=True)][21:30]
    assert all(sd < 0.7 * before for sd, before in middle)
    assert all(line.hidden > 0.95 and line.modes["behind"] == line.hidden for line in lines[20:31])
    assert lines[19].hidden > 0.8 > 0.2 > filtered[19].hidden
    with pytest.raises(KeptBeliefsError, match=r"keeps no trajectory of modes; allowed: belief: particles"):
        smooth(modal_run, most_probable=True)


def test_the_filter_is_not_changed_by_keeping(particle_run, tmp_path):
    plain = tracked("two_squares", "two_squares", tmp_path / "run")
    assert plain.metrics == particle_run.metrics


@pytest.mark.parametrize("name", ["particle_run", "gaussian_run"])
def test_a_smoothed_target_is_surer(name, request):
    run = request.getfixturevalue(name)
    after = smooth(run, draws=60)
    before, now = (np.array([line.sd[:2] for line in one.metrics[1:-1]]) for one in (run, after))
    assert now.mean() < before.mean()
    assert after.metrics[0] == run.metrics[0]
    np.testing.assert_allclose(after.metrics[-1].sd[:2], run.metrics[-1].sd[:2], rtol=0.05)
    assert after.events[0].smoothed and after.events[1:] == run.events[1:]
    kept = ("status", "score", "active", "kl", "log_evidence")
    for one, other in zip(after.metrics, run.metrics, strict=True):
        assert [getattr(one, field) for field in kept] == [getattr(other, field) for field in kept]


def test_gaussians_are_smoothed_by_the_motion_that_was_at_work(gaussian_run):
    kept = list(read_beliefs(gaussian_run.directory.beliefs))
    root = _root_of(gaussian_run.spec.targets["ball"])
    plain = make_plate_motion(root, {})
    size = gaussian_run.started.width, gaussian_run.started.height
    moves = [Move(motion_into(one, plain, root.motion, size), 1.0) for one in kept[1:]]
    exact = smooth_gaussians([one.posterior for one in kept], moves, root.belief.settings)
    found = smooth(gaussian_run).metrics
    for one, line in zip(exact[1:], found[1:], strict=True):
        np.testing.assert_allclose(line.centre_box, one.mean[:4], rtol=1e-9)


def test_the_same_again_is_the_same(particle_run):
    assert smooth(particle_run, 20, seed=3) == smooth(particle_run, 20, seed=3)
    assert smooth(particle_run, 20, seed=3) != smooth(particle_run, 20, seed=4)


def test_a_smoothed_run_is_written_and_read(particle_run, tmp_path):
    after = smooth(particle_run, 20)
    write_smoothed(particle_run, after, tmp_path / "smoothed")
    again = open_run(tmp_path / "smoothed")
    assert again.started.smoothed and verify(tmp_path / "smoothed").status == "verified"
    np.testing.assert_allclose(
        [line.centre_box for line in again.metrics], [line.centre_box for line in after.metrics], rtol=1e-6
    )
    assert (tmp_path / "smoothed/tracks.txt").read_text().count("\n") == FRAMES
    with pytest.raises(KeptBeliefsError, match="it has been smoothed"):
        smooth(again)
    with pytest.raises(RunDirectoryError, match="a run is there already"):
        write_smoothed(particle_run, after, tmp_path / "smoothed")
    write_smoothed(particle_run, after, tmp_path / "smoothed", overwrite=True)


def test_a_run_is_not_overwritten_by_itself(particle_run):
    path = particle_run.directory.path
    with pytest.raises(RunDirectoryError, match="the run that is smoothed; give another folder"):
        write_smoothed(particle_run, smooth(particle_run, 5), path, overwrite=True)
    assert verify(path).status == "verified"


def test_a_run_that_kept_no_beliefs_says_how_to(particle_run, tmp_path):
    shutil.copytree(particle_run.directory.path, tmp_path / "run")
    (tmp_path / "run/beliefs.jsonl").unlink()
    with pytest.raises(KeptBeliefsError, match="kept no beliefs; run it again with `keep_beliefs=True`"):
        smooth(open_run(tmp_path / "run"))


def test_a_belief_of_nobody_is_refused(particle_run, tmp_path):
    shutil.copytree(particle_run.directory.path, tmp_path / "run")
    path = tmp_path / "run/beliefs.jsonl"
    path.write_text(path.read_text().replace('"target":"1"', '"target":"7"'))
    with pytest.raises(KeptBeliefsError, match="target '7' never starts"):
        smooth(open_run(tmp_path / "run"))


@pytest.mark.parametrize("left", [0, 3])
def test_beliefs_that_end_before_the_run_are_refused(left, particle_run, tmp_path):
    shutil.copytree(particle_run.directory.path, tmp_path / "run")
    path = tmp_path / "run/beliefs.jsonl"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:left]))
    with pytest.raises(KeptBeliefsError, match=f"frame {FRAMES - 1}; it was cut short"):
        smooth(open_run(tmp_path / "run"))


def test_an_unfinished_run_is_smoothed_as_far_as_it_goes(tmp_path):
    run = tracked("two_squares", "two_squares", tmp_path / "run", stop=5, keep_beliefs=True)
    assert len(smooth(run).metrics) == len(run.metrics) > 3


def test_beliefs_go_on_where_a_run_is_resumed(particle_run, tmp_path):
    tracked("two_squares", "two_squares", tmp_path / "run", stop=5, keep_beliefs=True)
    list(resume(tmp_path / "run"))
    assert (tmp_path / "run/beliefs.jsonl").read_bytes() == particle_run.directory.beliefs.read_bytes()


def test_the_boxes_may_be_those_of_the_most_probable_trajectory(particle_run, gaussian_run):
    usual, best = smooth(particle_run, 20), smooth(particle_run, 20, most_probable=True)
    kept = {line.frame: line for line in best.metrics}
    for belief in list(read_beliefs(particle_run.directory.beliefs))[1:]:
        line = kept[belief.frame]
        assert np.abs(belief.posterior.states[:, :4] - line.map).max(axis=1).min() < 1e-6
        assert line.map == line.centre_box
    assert [line.sd for line in best.metrics] == [line.sd for line in usual.metrics]
    assert smooth(gaussian_run, most_probable=True) == smooth(gaussian_run)
