"""A person followed by depth through a run: colour only while somebody else is near; and what is refused."""

import json

import cv2
import numpy as np
import pytest

from bayesnet_track import Start, Tracker, open_run, track
from bayesnet_track.cli.main import main
from bayesnet_track.journal.events.faults import Quarantined
from bayesnet_track.journal.events.switches import Activated, Deactivated
from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.observation.planes import PointMap
from bayesnet_track.sources.paths import SourceError
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource
from bayesnet_track.vision.calibration import RectifiedPair, write_calibration


def play(name, seed):
    scene = make_scene(name, seed)
    source = SceneSource(scene, f"scene:{name}")
    results = list(track("person_stereo", source, [Start(scene.start_box)], seed=seed))
    boxes = np.array([result.targets[0].centre_box for result in results])
    return results, overlap(boxes, centre_from_corner(scene.truth))


def switched(results, kind):
    return [
        d.frame for result in results for d in result.decisions if isinstance(d, kind) and d.node == "color"
    ]


@pytest.mark.slow
def test_colour_is_on_only_while_somebody_else_is_near():
    """He comes into the picture at frame 60, passes behind the target at 100 and is out again at 145."""
    results, overlaps = play("person_stereo", 0)
    off, on = switched(results, Deactivated), switched(results, Activated)
    assert off[0] <= 20 and len(on) >= 1
    assert 60 <= on[0] <= 112 and off[-1] > on[-1]
    assert overlaps[-10:].mean() > 0.5
    assert np.mean([len(result.targets[0].active) for result in results]) < 1.4
    assert all("stereo" in result.targets[0].active for result in results)


@pytest.mark.slow
def test_eight_seeds_and_the_pane():
    """All of 6 seeds were held when this was written; at 95 % each, fewer than 6 of 8 has 0.6 %."""
    held = sum(play("person_stereo", seed)[1][-10:].mean() > 0.5 for seed in range(8))
    assert held >= 6
    assert play("glass_wall", 0)[1].mean() > 0.6


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The first frames of the scene as two folders, as halves of one picture, and their calibration."""
    folder, scene = tmp_path_factory.mktemp("pair"), make_scene("person_stereo", 0)
    for name in ("left", "right", "both"):
        (folder / name).mkdir()
    for index in range(4):
        eyes = scene.frames[index], scene.stereo.right[index]
        for name, image in zip(("left", "right", "both"), (*eyes, np.concatenate(eyes, axis=1)), strict=True):
            cv2.imwrite(str(folder / name / f"{index}.png"), image)
    write_calibration(folder / "pair.yml", RectifiedPair(320, 240, scene.stereo.geometry))
    return folder


def run(files, tmp_path, *more, out="run"):
    box = ",".join(str(v) for v in make_scene("person_stereo", 0).start_box)
    line = ["run", "person_stereo", "--init", box, "--out", str(tmp_path / out), "--quiet", *map(str, more)]
    return main(line)


@pytest.mark.slow
def test_both_ways_of_giving_a_pair_give_the_same(files, tmp_path):
    calibration = ("--calibration", files / "pair.yml")
    assert run(files, tmp_path, "--source", files / "left", "--right", files / "right", *calibration) == 0
    both = ("--source", files / "both", "--stereo", "side_by_side", *calibration)
    assert run(files, tmp_path, *both, out="halves") == 0
    one, other = ((tmp_path / name / "frames.npy.gz").read_bytes() for name in ("run", "halves"))
    assert one == other
    assert all("stereo" in m.active for m in open_run(tmp_path / "run").metrics)
    first = json.loads((tmp_path / "run" / "journal.jsonl").read_text().splitlines()[0])
    assert first["source"] == f"{files / 'left'} + {files / 'right'}"


def test_one_eye_is_refused_before_anything_is_written(files, tmp_path, capsys):
    assert run(files, tmp_path, "--source", files / "left") == 4
    said = capsys.readouterr().err
    assert "one eye, and stereo of the graph needs depth" in said
    assert "--right SOURCE" in said and "--calibration FILE" in said
    assert not (tmp_path / "run").exists()
    with pytest.raises(SourceError, match="stereo of the graph needs depth"):
        next(track("person_stereo", str(files / "left"), (90, 60, 40, 120)))


def test_the_tracker_takes_depth_and_does_without():
    scene = make_scene("person_stereo", 0)
    tracker = Tracker("person_stereo")
    tracker.init(scene.frames[0], scene.start_box, depth=scene.stereo.eye(0))
    for index in (1, 2):
        ok, _ = tracker.update(scene.frames[index], depth=scene.stereo.eye(index))
    assert ok and "stereo" in tracker.metrics.active
    with pytest.raises(ValueError, match="depth of shape"):
        tracker.update(scene.frames[3], depth=PointMap(np.zeros((5, 5, 3), np.float32)))
    tracker.init(scene.frames[0], scene.start_box)
    (out,) = (event for event in tracker.events if isinstance(event, Quarantined))
    assert out.node == "stereo" and "needs depth, and the source is one eye" in out.reason


@pytest.mark.parametrize(
    ("more", "code", "said"),
    [
        (("--right", "right"), 4, "without a calibration"),
        (("--right", "right", "--calibration", "nowhere.yml"), 4, "nowhere.yml"),
        (("--right", "gone", "--calibration", "pair.yml"), 4, "no such file or folder"),
        (("--stereo", "side_by_side", "--calibration", "pair.yml"), 4, "the calibration is for 320x240"),
        (("--calibration", "pair.yml"), 2, "--calibration is of a pair"),
    ],
)
def test_mistakes_with_pairs(files, tmp_path, capsys, more, code, said):
    named = [
        str(files / word) if not word.startswith("--") and word != "side_by_side" else word for word in more
    ]
    assert run(files, tmp_path, "--source", files / "left", *named) == code
    assert said in capsys.readouterr().err and not (tmp_path / "run").exists()
