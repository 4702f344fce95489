"""Kept beliefs as draws for ArviZ: the moments, the weights and the likelihoods are those of the run."""

import shutil
from importlib import import_module

import numpy as np
import pytest

from bayesnet_track import Start, open_run, track
from bayesnet_track.cli.main import main
from bayesnet_track.runtime.recording import exports
from bayesnet_track.runtime.recording.beliefs import read_beliefs
from bayesnet_track.runtime.recording.exports import ArvizError, beliefs_as_dataset, write_arviz
from bayesnet_track.runtime.smoothing import KeptBeliefsError
from bayesnet_track.sources.scenes.library import SceneSource

xarray = pytest.importorskip("xarray")
pytest.importorskip("h5netcdf")

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
def test_draws_have_the_moments_of_the_belief(name, request):
    run = request.getfixturevalue(name)
    dataset = beliefs_as_dataset(run, DRAWS)
    for kept in read_beliefs(run.directory.beliefs):
        belief = kept.posterior
        for column, field in enumerate(belief.fields):
            values = dataset[field].sel(chain=0, target="1", frame=kept.frame).values
            variance = belief.covariance[column, column]
            assert is_mean(values, belief.mean[column], variance)
            np.testing.assert_allclose(values.var(), variance, rtol=6 * np.sqrt(4 / DRAWS), atol=1e-3)


def test_likelihoods_of_the_agents_are_what_the_particles_were_weighed_by(particle_run):
    for kept in list(read_beliefs(particle_run.directory.beliefs))[1:]:
        said, log = sum(kept.heard.log_likelihoods.values()), kept.posterior.weights.log
        heavy = log > log.max() - 10
        rest = (log - said)[heavy]
        np.testing.assert_allclose(rest, rest.mean(), atol=1e-4)


def test_draws_of_a_particle_have_its_likelihood(particle_run):
    drawn = beliefs_as_dataset(particle_run, 50).sel(chain=0, target="1", frame=3)
    kept = list(read_beliefs(particle_run.directory.beliefs))[3]
    assert kept.heard.log_likelihoods
    for agent, values in kept.heard.log_likelihoods.items():
        by_place = dict(zip(map(tuple, kept.posterior.states[:, :2].astype(np.float32)), values, strict=True))
        places = zip(drawn.x.values, drawn.y.values, strict=True)
        found = drawn[f"log_likelihood_{agent}"].values
        np.testing.assert_allclose(found, [by_place[place] for place in places], rtol=1e-6)


def test_measurements_are_those_of_the_run_and_absent_where_nothing_was_measured(gaussian_run):
    dataset = beliefs_as_dataset(gaussian_run, 5).sel(target="1")
    agents = 0
    for kept in read_beliefs(gaussian_run.directory.beliefs):
        for agent, measurement in kept.heard.measured.items():
            for field, value in zip(measurement.fields, measurement.mean, strict=True):
                found = dataset[f"measured_{agent}_{field}"].sel(frame=kept.frame)
                assert found == np.float32(value)
                agents += 1
    assert agents == sum(int(v.notnull().sum()) for n, v in dataset.items() if n.startswith("measured"))


def test_the_file_is_opened_by_xarray(gaussian_run, tmp_path):
    write_arviz(gaussian_run, tmp_path / "run.nc", 20)
    with xarray.open_dataset(tmp_path / "run.nc", group="posterior", engine="h5netcdf") as found:
        assert found.x.dims == ("chain", "draw", "target", "frame")
        assert found.x.shape == (1, 20, 1, FRAMES)
        xarray.testing.assert_identical(found.load(), beliefs_as_dataset(gaussian_run, 20))
        assert found.kind.values.tolist() == ["ball"] and found.attrs["graph"] == "kalman_ball"
        assert found.time_s.values.tolist() == [line.time_s for line in gaussian_run.metrics]


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
    with pytest.raises(KeptBeliefsError, match="run it again with `keep_beliefs=True`"):
        beliefs_as_dataset(open_run(tmp_path / "run"), 10)


def test_too_many_numbers_are_refused(particle_run, monkeypatch):
    monkeypatch.setattr(exports, "MAX_NUMBERS", 1000)
    with pytest.raises(ArvizError, match="fewer draws"):
        beliefs_as_dataset(particle_run)


def test_what_is_not_installed_is_named_with_the_cure(particle_run, tmp_path, monkeypatch):
    def missing(name):
        if name == "xarray":
            raise ModuleNotFoundError("No module named 'xarray'", name=name)
        return import_module("json")

    monkeypatch.setattr(exports, "import_module", missing)
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
        def to_netcdf(self, path, group, engine):
            path.write_bytes(b"half")
            raise OSError("the disk is full")

    path = tmp_path / "one.nc"
    path.write_bytes(b"old")
    monkeypatch.setattr(exports, "beliefs_as_dataset", lambda *_: Broken())
    with pytest.raises(OSError, match="full"):
        write_arviz(particle_run, path)
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]
