"""Scores by class, and what shows that two files do not go together."""

import json

import pytest

from bayesnet_track.cli.main import main
from bayesnet_track.evaluate.mot import (
    score_classes,
    score_mot,
    score_mot_files,
)
from bayesnet_track.evaluate.truth import class_names, of_classes, read_mot_tracks, read_mot_truth
from bayesnet_track.sources.entrances.notices import InputNotice

PERSON = [f"{f},1,{10 + f},10,20,20,1,1,1" for f in range(1, 6)]
CAR = [f"{f},1,{100 + f},60,40,20,1,3,1" for f in range(1, 6)]
TRACKED = [line.replace(",1,1,1", ",1,-1,-1,-1") for line in PERSON]
TRACKED += [line.replace(",1,", ",2,", 1).replace(",1,3,1", ",1,-1,-1,-1") for line in CAR[:4]]
"""The person in every frame, the car in four of five; without classes."""


@pytest.fixture
def files(tmp_path):
    """Writes both files; gives their paths."""

    def write(truth, tracks):
        paths = [tmp_path / "gt.txt", tmp_path / "tracks.txt"]
        for path, lines in zip(paths, (truth, tracks), strict=True):
            path.write_text("\n".join(lines) + "\n")
        return paths

    return write


def test_an_identity_is_one_of_a_class(files):
    truth, tracks = files(PERSON + CAR, TRACKED)
    score = score_mot_files(tracks, truth)
    assert (score.true_ids, score.true_boxes, score.fn, score.fp, score.idsw) == (2, 10, 1, 0, 0)
    assert class_names(read_mot_truth(truth)) == ["1", "3"]


@pytest.mark.parametrize("has_classes", [False, True])
def test_each_class_is_scored_by_itself(files, has_classes):
    """A track of the person on the car is false for the car if tracks have classes, else it is the car's."""
    tracked = (PERSON + CAR[:4]) if has_classes else TRACKED
    truth, tracks = (
        read(path)
        for read, path in zip((read_mot_truth, read_mot_tracks), files(PERSON + CAR, tracked), strict=True)
    )
    found = score_classes(truth, tracks)
    assert [(one.true_boxes, one.track_boxes, one.fn, one.fp) for one in found.values()] == [
        (5, 5, 0, 0),
        (5, 4, 1, 0),
    ]
    assert found["3"].mota == pytest.approx(0.8)
    alone = score_mot(*of_classes(truth, tracks, ["1"]))
    assert (alone.true_ids, alone.mota, alone.idf1) == (1, 1.0, 1.0)
    with pytest.raises(ValueError, match="class 'car' is not in the ground truth; it has 1, 3"):
        of_classes(truth, tracks, ["1", "car"])


def test_a_doubtful_class_does_not_break_a_track(files):
    truth, tracks = files(
        PERSON, [line.replace(",1,1,1", ",1,3,1") if k % 2 else line for k, line in enumerate(PERSON)]
    )
    assert score_mot_files(tracks, truth).idf1 == 1.0


def test_identities_of_64_bits_stay_apart(files):
    big = [2**63 - 1, 2**63 - 2]
    lines = [f"{f},{one},{50 * k},0,20,20,1" for k, one in enumerate(big) for f in (1, 2, 3)]
    truth, tracks = files(lines, lines)
    assert read_mot_truth(truth).ids.tolist() == [big[0]] * 3 + [big[1]] * 3
    assert score_mot_files(tracks, truth).true_ids == 2


@pytest.mark.parametrize(
    ("options", "boxes", "classes"),
    [([], 10, ["1", "3"]), (["--class", "3"], 5, []), (["--class", "3", "--class", "1"], 10, ["3", "1"])],
)
def test_the_command_scores_by_class(files, capsys, options, boxes, classes):
    truth, tracks = files(PERSON + CAR, TRACKED)
    assert main(["score", str(tracks), "--truth", str(truth), "--json", *options]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["true_boxes"] == boxes and list(shown.get("classes", {})) == classes
    assert main(["score", str(tracks), "--truth", str(truth), *options]) == 0
    assert ("\nclass " in capsys.readouterr().out) == bool(classes)


def test_a_class_that_is_not_there_is_the_users_mistake(files, capsys):
    truth, tracks = files([line.rsplit(",", 2)[0] for line in PERSON], TRACKED)
    assert main(["score", str(tracks), "--truth", str(truth), "--class", "1"]) == 2
    assert "class '1' is not in the ground truth; its boxes have no class" in capsys.readouterr().err


def test_what_is_not_scored_or_counts_as_missed_is_said(files):
    truth, tracks = files(
        [f"{f},1,0,0,9,9,{f % 2}" for f in range(1, 61)], [f"{f},1,0,0,9,9,1" for f in range(1, 31)]
    )
    with pytest.warns(InputNotice) as said:
        score = score_mot_files(tracks, truth)
    assert score.fn == 15 and [str(one.message) for one in said] == [
        f"{truth}: 30 of 60 boxes have confidence 0 and are not scored",
        f"{truth}: 15 of 30 true boxes are of frames after the last tracked box (30 to 58, counted from 0), "
        "and count as missed: is the file of this video, and of its frame rate?",
    ]
