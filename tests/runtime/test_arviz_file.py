"""Kept beliefs as draws for ArviZ: the moments, the weights and the likelihoods are those of the run."""

import shutil
from importlib import import_module

import numpy as np
import pytest

from bayesnet_track import Start, open_run, track
from bayesnet_track.cli.main import main
from bayesnet_track.runtime.lifetimes import KeptBeliefsError, moves_of
from bayesnet_track.runtime.recording import arviz_file
from bayesnet_track.runtime.recording.arviz_file import ArvizError, beliefs_as_groups, write_arviz
from bayesnet_track.runtime.recording.beliefs import read_beliefs
from bayesnet_track.sources.scene_source import SceneSource

FRAMES, DRAWS = 6, 2000


def tracked(graph, scene, out):
    source = SceneSource.named(scene, 0, FRAMES)
    list(track(graph, source, [Start(source.scene.start_box)], out=out, keep_beliefs=True))
    return open_run(out)


@pytest.fixture(scope="module")
def particle_run(tmp_path_factory):
    return tracked("two_squares", "two_squares", tmp_path_factory.mktemp("kept") / "run")


@pytest.fixture(scope="module")
def gaussian_run(tmp_path_factory):
    return tracked("kalman_ball", "flying_ball", tmp_path_factory.mktemp("kept") / "run")


def is_mean(draws, mean, variance):
    return np.abs(draws.mean(axis=0) - mean) <= 5 * np.sqrt(variance / DRAWS) + 1e-3


@pytest.mark.parametrize("name", ["particle_run", "gaussian_run"])
def test_draws_have_the_moments_of_the_belief_and_of_its_prediction(name, request):
    run = request.getfixturevalue(name)
    groups = beliefs_as_groups(run, DRAWS, seed=0)
    lifetime = list(read_beliefs(run.directory.beliefs))
    for at, kept in enumerate(lifetime):
        belief = kept.posterior
        for column, field in enumerate(belief.fields):
            values = groups.sampled["posterior"][field][:, 0, at]
            variance = belief.covariance[column, column]
            assert is_mean(values, belief.mean[column], variance)
            np.testing.assert_allclose(values.var(), variance, rtol=6 * np.sqrt(4 / DRAWS), atol=1e-3)
    assert np.isnan(groups.sampled["prior"]["x"][:, 0, 0]).all()
    for at, move in enumerate(moves_of(run, lifetime), start=1):
        before = lifetime[at - 1].posterior
        ahead = move.motion.drift(before.mean[None], move.dt)[0]
        values = groups.sampled["prior"]["x"][:, 0, at]
        assert is_mean(values, ahead[0], values.var())


def test_likelihoods_of_the_agents_are_what_the_particles_were_weighed_by(particle_run):
    for kept in list(read_beliefs(particle_run.directory.beliefs))[1:]:
        said, log = sum(kept.heard.log_likelihoods.values()), kept.posterior.weights.log
        heavy = log > log.max() - 10
        rest = (log - said)[heavy]
        np.testing.assert_allclose(rest, rest.mean(), atol=1e-4)


def test_draws_of_a_particle_have_its_likelihood(particle_run):
    groups = beliefs_as_groups(particle_run, 50, seed=0)
    kept = list(read_beliefs(particle_run.directory.beliefs))[3]
    for agent, values in kept.heard.log_likelihoods.items():
        by_place = dict(zip(map(tuple, kept.posterior.states[:, :2].astype(np.float32)), values, strict=True))
        x, y = (groups.sampled["posterior"][name][:, 0, 3] for name in "xy")
        found = groups.sampled["log_likelihood"][agent][:, 0, 3]
        np.testing.assert_allclose(found, [by_place[place] for place in zip(x, y, strict=True)], rtol=1e-6)


def test_measurements_are_predicted_by_the_draws_and_their_error(gaussian_run):
    groups = beliefs_as_groups(gaussian_run, DRAWS, seed=0)
    for at, kept in enumerate(read_beliefs(gaussian_run.directory.beliefs)):
        for agent, one in kept.heard.measured.items():
            places = [kept.posterior.fields.index(name) for name in one.fields]
            spread = kept.posterior.covariance[np.ix_(places, places)] + one.covariance
            for n, field in enumerate(one.fields):
                values = groups.sampled["posterior_predictive"][f"{agent}_{field}"][:, 0, at]
                assert is_mean(values, kept.posterior.mean[places[n]], spread[n, n])
                np.testing.assert_allclose(values.var(), spread[n, n], rtol=6 * np.sqrt(2 / DRAWS))
                assert groups.observed[f"{agent}_{field}"][0, at] == one.mean[n]
            x = np.stack([groups.sampled["posterior"][f][:, 0, at] for f in one.fields], axis=1) - one.mean
            expected = -0.5 * np.einsum("ni,ij,nj->n", x, np.linalg.inv(one.covariance), x)
            found = groups.sampled["log_likelihood"][agent][:, 0, at]
            np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-3)


def test_the_file_is_opened_by_xarray(gaussian_run, tmp_path):
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    write_arviz(gaussian_run, tmp_path / "run.nc", 20)
    with xarray.open_datatree(tmp_path / "run.nc", engine="h5netcdf") as tree:
        assert set(tree.children) == {
            "posterior",
            "prior",
            "log_likelihood",
            "posterior_predictive",
            "sample_stats",
            "observed_data",
            "constant_data",
        }
        assert dict(tree["posterior"].sizes) == {"chain": 1, "draw": 20, "target": 1, "frame": FRAMES}
        evidence = [line.log_evidence for line in gaussian_run.metrics]
        np.testing.assert_array_equal(tree["sample_stats"]["log_evidence"].values[0], evidence)
        assert tree["constant_data"]["kind"].values.tolist() == ["ball"]
        assert tree.attrs["graph"] == "kalman_ball"


def test_the_file_is_opened_by_arviz(particle_run, tmp_path):
    arviz = pytest.importorskip("arviz", minversion="1")
    out = str(tmp_path / "run.nc")
    assert main(["export", str(particle_run.directory.path), "--format", "arviz", "-o", out]) == 0
    tree = arviz.from_netcdf(out)
    kept = list(read_beliefs(particle_run.directory.beliefs))[3].posterior
    summary = arviz.summary(tree.posterior.dataset[["x", "y"]].isel(frame=3, target=0), round_to="none")
    found = summary.loc[["x", "y"], "mean"].to_numpy(dtype=float)
    np.testing.assert_allclose(found, kept.mean[:2], atol=5 * np.sqrt(kept.covariance[0, 0] / 500))
    assert 250 < arviz.ess(tree.posterior.dataset[["x"]].isel(frame=3, target=0)).x < 1000


def test_a_run_without_beliefs_is_refused_with_the_cure(particle_run, tmp_path):
    shutil.copytree(particle_run.directory.path, tmp_path / "run")
    (tmp_path / "run/beliefs.jsonl").unlink()
    with pytest.raises(KeptBeliefsError, match="run it again with `--keep-beliefs`"):
        beliefs_as_groups(open_run(tmp_path / "run"), 10, 0)


def test_too_many_numbers_are_refused(particle_run, monkeypatch):
    monkeypatch.setattr(arviz_file, "MOST_NUMBERS", 1000)
    with pytest.raises(ArvizError, match="fewer --draws"):
        beliefs_as_groups(particle_run, 500, 0)


def test_what_is_not_installed_is_named_with_the_cure(particle_run, tmp_path, monkeypatch):
    def missing(name):
        if name == "xarray":
            raise ModuleNotFoundError("No module named 'xarray'", name=name)
        return import_module("json")

    monkeypatch.setattr(arviz_file, "import_module", missing)
    with pytest.raises(ArvizError, match=r"xarray is not installed; pip install 'bayesnet-track\[arviz\]'"):
        write_arviz(particle_run, tmp_path / "run.nc")


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["--format", "arviz"], "give its name with --out"),
        (["--format", "arviz", "--lost", "-o", "a.nc"], "which writes every belief"),
        (["--format", "csv", "--draws", "5"], "it is for --format arviz"),
    ],
)
def test_options_of_the_other_formats_are_refused(particle_run, words, found, capsys):
    assert main(["export", str(particle_run.directory.path), *words]) == 2
    assert found in capsys.readouterr().err


def test_what_is_no_run_is_named(tmp_path, capsys):
    arguments = ["export", str(tmp_path), "--format", "arviz", "-o", str(tmp_path / "a.nc")]
    assert main(arguments) == main(["export", str(tmp_path), "--format", "csv"])
    assert capsys.readouterr().err.count("not a run directory") == 2


def test_what_cannot_be_written_whole_leaves_the_file_as_it_was(particle_run, tmp_path, monkeypatch):
    class Broken:
        def to_netcdf(self, path, engine):
            path.write_bytes(b"half")
            raise OSError("the disk is full")

    path = tmp_path / "one.nc"
    path.write_bytes(b"old")
    monkeypatch.setattr(arviz_file, "_xarray", lambda: None)
    monkeypatch.setattr(arviz_file, "_tree", lambda *_: Broken())
    with pytest.raises(OSError, match="full"):
        write_arviz(particle_run, path)
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]
