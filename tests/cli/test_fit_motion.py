"""`fit --motion` reads boxes, writes what they tell into the graph, and says what does not go."""

import numpy as np
import pytest

from bayesnet_track import load_graph
from bayesnet_track.cli.main import main

GRAPH = """# my graph
bayesnet: 1
name: mine
targets:
  target:
    nodes:
      target:
        belief: {particles: {size: 100}}
        motion: {random_walk: {sd_px: {x: 40, y: 4}}}  # moves
      gray: {parent: target, agent: intensity}
"""


@pytest.fixture
def place(tmp_path):
    rng = np.random.default_rng(0)
    path = np.cumsum(rng.normal(0, [8.0, 4.0], (120, 2)), axis=0) + 500 + rng.normal(0, 1, (120, 2))
    lines = [f"{x:.2f},{y:.2f},20,20\n" for x, y in path]
    lines[60] = "NaN,NaN,NaN,NaN\n"
    (tmp_path / "one.txt").write_text("".join(lines))
    mot = [f"{n + 1},{1 + n // 60},{x:.2f},{y:.2f},20,20,1,-1,-1,-1\n" for n, (x, y) in enumerate(path)]
    (tmp_path / "many.txt").write_text("".join(mot))
    (tmp_path / "g.yaml").write_text(GRAPH)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize(("file", "tracks"), [("one.txt", "1 track"), ("many.txt", "2 tracks")])
def test_the_noise_is_written_into_the_graph(place, file, tracks, capsys):
    out = place / "fitted.yaml"
    call = ["fit", str(place / "g.yaml"), "--motion", "--truth", str(place / file), "--box-sd", "1"]
    assert main([*call, "--out", str(out)]) == 0
    said = capsys.readouterr()
    assert "motion.random_walk.sd_px.x: " in said.err and "; before 40" in said.err
    text = out.read_text()
    assert text.startswith("# my graph") and f"(90 %), by evidence; 118 frames of {tracks}" in text
    sd = load_graph(out).targets["target"].inference("target").motion.settings.sd_px
    assert 6.5 < sd.x < 9.5 and 3.2 < sd.y < 4.8


@pytest.mark.slow
def test_a_bare_motion_gets_its_value(place):
    (place / "g.yaml").write_text(GRAPH.replace("{random_walk: {sd_px: {x: 40, y: 4}}}", "constant_velocity"))
    call = ["fit", str(place / "g.yaml"), "--motion", "--truth", str(place / "one.txt")]
    assert main([*call, "--out", str(place / "fitted.yaml")]) == 0
    motion = load_graph(place / "fitted.yaml").targets["target"].inference("target").motion
    assert motion.kind == "constant_velocity" and motion.settings.sd_velocity_px > 1


def test_wrong_uses_are_explained(place, capsys):
    graph, truth = str(place / "g.yaml"), str(place / "one.txt")
    (place / "few.txt").write_text("1,2,3,4\n" * 5)
    (place / "bad.txt").write_text("1,2,3\n")
    own = GRAPH.replace("random_walk: {sd_px: {x: 40, y: 4}}", "expressions: {sd: {x: 1}}")
    (place / "e.yaml").write_text(own)
    wrong = {
        "--motion reads boxes and no images: give --truth FILE": [graph],
        "--motion fits the motion alone; call --what": [graph, "--truth", truth, "--what", "ud"],
        "4 frames with a box after the first; at least 20": [graph, "--truth", str(place / "few.txt")],
        "bad.txt:1: 3 numbers": [graph, "--truth", str(place / "bad.txt")],
        "expressions cannot be fitted; allowed: random_walk": [str(place / "e.yaml"), "--truth", truth],
    }
    for text, more in wrong.items():
        assert main(["fit", *more, "--motion"]) == 2
        assert text in capsys.readouterr().err
