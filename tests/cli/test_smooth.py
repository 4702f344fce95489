"""`smooth` makes a run of a run, and refuses one that cannot be smoothed."""

import pytest

from bayesnet_track.cli.main import main


@pytest.fixture(scope="module")
def plain_run(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo") / "run"
    assert main(["demo", "--end", "4", "--quiet", "--out", str(out)]) == 0
    return out


def test_a_run_without_beliefs_is_refused(plain_run, tmp_path, capsys):
    assert main(["smooth", str(plain_run), "--out", str(tmp_path / "smoothed")]) == 2
    assert "it kept no beliefs; run it again with `--keep-beliefs`" in capsys.readouterr().err
    assert not (tmp_path / "smoothed").exists()


def test_a_folder_that_is_no_run_is_refused(tmp_path, capsys):
    assert main(["smooth", str(tmp_path), "--out", str(tmp_path / "smoothed")]) == 4
    assert "not a run directory" in capsys.readouterr().err


def test_the_whole_path(tmp_path, capsys):
    import cv2
    import numpy as np

    rng = np.random.default_rng(0)
    pattern = rng.integers(0, 255, (12, 16, 3), np.uint8)
    (tmp_path / "img").mkdir()
    for n in range(6):
        image = np.full((56, 72, 3), 90, np.uint8)
        image[14:26, 20 + 2 * n : 36 + 2 * n] = pattern
        cv2.imwrite(str(tmp_path / f"img/{n}.png"), image)
    run, out = str(tmp_path / "run"), str(tmp_path / "smoothed")
    source = ["--source", str(tmp_path / "img"), "--init", "20,14,16,12", "--quiet", "--keep-beliefs"]
    assert main(["run", "general", *source, "--out", run]) == 0
    assert main(["smooth", run, "--out", out, "--draws", "20"]) == 0
    assert "6 frames smoothed" in capsys.readouterr().out
    assert main(["log", out]) == 0
    assert capsys.readouterr().out.startswith("smoothed run of general")
    assert main(["verify", out]) == 0
    capsys.readouterr()
    assert main(["compare", run, out]) == 0
    header = f"A  {run}\nB  {out} (smoothed)\n\ndiffer in\n  estimates: filtered → smoothed\n"
    assert capsys.readouterr().out.startswith(header)
    assert main(["what-if", out, "--quiet"]) == 2
    assert f"{out}: it has been smoothed; use the run that it was made from" in capsys.readouterr().err
    assert not (tmp_path / "smoothed-what-if").exists()


def test_particles_from_elsewhere_have_no_most_probable_trajectory(tmp_path, capsys):
    import cv2
    import numpy as np

    image = np.full((56, 72, 3), 90, np.uint8)
    image[14:26, 20:36] = np.random.default_rng(0).integers(0, 255, (12, 16, 3), np.uint8)
    (tmp_path / "img").mkdir()
    for n in range(3):
        cv2.imwrite(str(tmp_path / f"img/{n}.png"), image)
    run = str(tmp_path / "run")
    source = ["--source", str(tmp_path / "img"), "--init", "20,14,16,12", "--quiet", "--keep-beliefs"]
    for change in (
        "motion.random_walk.relocalize={share: 0.1, usual: 0.1}",
        "belief.particles.when={ess_below: 0.5}",
    ):
        call = ["run", "general", *source, "--set", f"target.{change}", "--out", run, "--overwrite"]
        assert main(call) == 0
        assert main(["smooth", run, "--out", str(tmp_path / "smoothed"), "--map"]) == 2
        assert "smooth without --map" in capsys.readouterr().err


def test_a_belief_that_cannot_be_kept_is_refused_before_the_run(tmp_path, capsys):
    import cv2
    import numpy as np

    for n in range(2):
        cv2.imwrite(str(tmp_path / f"{n}.png"), np.full((56, 72, 3), 90, np.uint8))
    (tmp_path / "late.csv").write_text("frame,x\n0,20\n1,20\n", encoding="utf-8")
    graph = tmp_path / "late.yaml"
    graph.write_text(
        "bayesnet: 1\nname: late\ntargets:\n  ball:\n    nodes:\n"
        "      ball: {belief: {gaussian: {filter: extended}}, motion: {constant_velocity: {}}}\n"
        "      late: {parent: ball, agent: {readings: {file: FILE, sd: {x: 2}, delay: 1}}}\n".replace(
            "FILE", str(tmp_path / "late.csv")
        ),
        encoding="utf-8",
    )
    source = ["--source", str(tmp_path / "*.png"), "--init", "20,14,16,12", "--quiet", "--keep-beliefs"]
    assert main(["run", str(graph), *source, "--out", str(tmp_path / "run")]) == 2
    assert "ball.late has a delay, and beliefs with their past cannot be smoothed" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
