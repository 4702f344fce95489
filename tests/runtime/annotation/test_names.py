"""Names of targets: what is kept can be read back, by any entrance, and a bad name loses no answer."""

import contextlib
import json
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayesnet_track.runtime.annotation.answers import (
    BEFORE,
    Answer,
    AnswerError,
    Header,
    describe_fault,
    mend_names,
    read_answer,
    read_answers,
)
from bayesnet_track.runtime.annotation.asking import TrackedBox
from bayesnet_track.runtime.annotation.desk import WRITERS, read_annotations
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.runtime.annotation.session import open_session
from bayesnet_track.sources.entrances.notices import InputNotice

VIDEO = Video("made_up.mp4", 6, 320, 240, 0.04, "abc")
HEADER = Header(VIDEO, "general", "0" * 64, 0, 0.5, 1, "1.0")
BAD = (
    "",
    " ",
    "ball\N{NO-BREAK SPACE}1",
    "ball\t1",
    "ball\n1",
    "ball\N{LINE SEPARATOR}1",
    "ball\x00",
    "\ud800 1",
    "\ufeffball 1",
    " ball 1",
    "ball 1 ",
    "b" * 81,
    "b" * 79 + " 1",
    "b" * 79 + " 2",
    "soft\N{SOFT HYPHEN}hyphen",
)


class Still:
    """Every target stays where it is."""

    def at(self, start, box, frame):
        return TrackedBox(box, 0.9, (1.0, 1.0), "tracking")


def line(target, frame=0, x=10.0):
    return {"kind": "box", "frame": frame, "target": target, "box": [x, 10.0, 20.0, 20.0]}


@given(st.lists(st.text(st.characters(exclude_categories=()), max_size=90), max_size=12))
def test_mended_names_have_no_fault_and_two_never_become_one(names):
    mended = mend_names(names)
    kept = [mended.get(name, name) for name in dict.fromkeys(names)]
    assert [describe_fault(name) for name in kept] == [None] * len(kept)
    assert len(set(kept)) == len(kept)
    assert set(mended) == {name for name in names if describe_fault(name) is not None}


ANYTHING = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 8),
    st.floats(),
    st.text(max_size=4),
    st.lists(st.integers(), max_size=2),
)
NUMBER = st.one_of(st.integers(-10, 400), st.floats(-1e3, 1e4), st.floats(), st.just(10**400), st.just("5"))
MESSAGE = st.fixed_dictionaries(
    {},
    optional={
        "kind": st.one_of(st.sampled_from(["box", "correct", "gone", "undo"]), ANYTHING),
        "frame": st.one_of(st.integers(0, 5), ANYTHING),
        "target": st.one_of(
            st.just("ball 1"), st.text(st.characters(exclude_categories=()), max_size=90), ANYTHING
        ),
        "box": st.one_of(st.lists(NUMBER, min_size=4, max_size=4), ANYTHING),
    },
)


@settings(max_examples=12)
@given(st.lists(MESSAGE, max_size=8))
def test_every_message_is_refused_with_words_or_kept_as_it_is_read_back(messages):
    with tempfile.TemporaryDirectory() as folder:
        session, _ = open_session(Path(folder), HEADER)
        for message in messages:
            with contextlib.suppress(AnswerError):
                session.give(message)
        session.update(Still())
        session.close()
        assert read_answers(session.path).answers == tuple(session.answers)
        assert session.annotations.failures == ()
        for write in WRITERS.values():
            write(session.document)


@pytest.mark.parametrize("name", [*BAD, 7, None, ["ball"]])
def test_the_page_is_refused_a_name_that_cannot_be_kept(name, tmp_path):
    session, _ = open_session(tmp_path, HEADER)
    with pytest.raises(AnswerError, match=r"target|name"):
        session.give({**line("ball 1"), "target": name})
    assert read_answers(session.path).answers == ()


def test_every_bad_name_of_a_file_is_imported_under_a_name_that_is_read_back_and_written(tmp_path):
    """As COCO, whose names come as they are; the same import later adds nothing."""
    names = ("ball 1", *BAD)
    coco = {
        "images": [{"id": n, "frame_id": n, "width": 320, "height": 240, "file_name": ""} for n in range(6)],
        "categories": [{"id": 1, "name": "ball"}],
        "tracks": [{"id": n, "name": name, "category_id": 1} for n, name in enumerate(names)],
        "annotations": [
            {"image_id": 0, "track_id": n, "category_id": 1, "bbox": [10 + n, 10, 20, 20]}
            for n in range(len(names))
        ],
    }
    (tmp_path / "coco.json").write_text(json.dumps(coco))
    session, _ = open_session(tmp_path / "a", HEADER)
    answers = read_annotations(tmp_path / "coco.json", VIDEO)
    with pytest.warns(InputNotice, match=r"coco.json: names of targets .* is now 'ball 2'"):
        session.give_new(answers, "coco.json")
    data = session.path.read_bytes()
    again, _ = open_session(tmp_path / "a", HEADER)
    with pytest.warns(InputNotice):
        again.give_new(answers, "coco.json")
    assert session.path.read_bytes() == data
    again.update(Still())
    assert [own[0].box[0] for own in again.annotations.marks.values()] == [10 + n for n in range(len(names))]
    for write in WRITERS.values():
        for file, content in write(again.document).items():
            (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / file).write_bytes(content)
    for file in ("coco.json", "cvat.xml", "label_studio.json", "mot.txt"):
        assert len({one.target for one in read_annotations(tmp_path / file, VIDEO)}) == len(names)


def test_an_imported_name_that_is_mended_becomes_no_target_that_is_there(tmp_path):
    session, _ = open_session(tmp_path, HEADER)
    session.give(line("target 1"))
    imported = [Answer("box", 0, name, (50.0, 10.0, 20.0, 20.0)) for name in ("", "\t")]
    for _ in range(2):  # the second time the same file is known
        with pytest.warns(InputNotice, match=r"'' is now 'target 2', '\\t' is now 'target 3'"):
            session.give_new(imported, "x.json")
    assert [(one.target, one.box[0]) for one in session.answers] == [
        ("target 1", 10.0),
        ("target 2", 50.0),
        ("target 3", 50.0),
    ]


def test_a_session_with_names_that_were_kept_unchecked_opens_again(tmp_path):
    """Its file as a version wrote it that kept any name of an import."""
    session, _ = open_session(tmp_path, HEADER)
    session.give(line("ball 2"))
    session.close()
    with session.path.open("a") as file:
        for number, name in enumerate(BAD):
            file.write(json.dumps(line(name, x=20.0 + number)) + "\n")
        file.write(json.dumps({"kind": "gone", "frame": 3, "target": BAD[2]}) + "\n")
    before = session.path.read_bytes()
    with pytest.warns(InputNotice, match=r"'ball\\xa01' is now 'ball 1'.*answers.before.jsonl"):
        again, _ = open_session(tmp_path, HEADER)
    assert (tmp_path / BEFORE).read_bytes() == before
    assert [one.box[0] for one in again.answers if one.box] == [10.0, *(20.0 + n for n in range(len(BAD)))]
    assert len({one.target for one in again.answers}) == len(BAD) + 1
    assert again.answers[-1] == Answer("gone", 3, "ball 1")
    # It is gone on with by the new names, and is read as it stands from then on.
    again.give(line("ball 1", 5))
    third, _ = open_session(tmp_path, HEADER)
    assert third.answers == again.answers


def test_names_that_differ_in_case_stay_two_targets_and_that_is_said(tmp_path):
    session, _ = open_session(tmp_path, HEADER)
    answers = [read_answer(line(name), 6, 320, 240) for name in ("car 1", "Car 1", "e\u0301", "\u00e9")]
    with pytest.warns(InputNotice, match="look alike and are two targets"):
        session.give_new(answers, "x.json")
    assert len(open_session(tmp_path, HEADER)[0].answers) == 4


@pytest.mark.parametrize("end", [b"", b"\r\n", b"\n\n"])
def test_a_file_edited_by_hand_loses_no_answer(tmp_path, end):
    """An editor that ends no last line, that ends lines as Windows does, that leaves an empty one."""
    session, _ = open_session(tmp_path, HEADER)
    session.give(line("ball 1"))
    session.close()
    edited = session.path.read_bytes() + json.dumps(line("ball 1", 4)).encode()
    session.path.write_bytes((edited.replace(b"\n", b"\r\n") if b"\r" in end else edited) + end)
    again, _ = open_session(tmp_path, HEADER)
    again.give(line("ball 1", 5))
    assert [one.frame for one in open_session(tmp_path, HEADER)[0].answers] == [0, 4, 5]


@pytest.mark.parametrize("edit", ["utf-16", "header", "twice"])
def test_a_file_that_cannot_be_read_is_refused_with_its_line_and_stays_as_it_is(tmp_path, edit):
    session, _ = open_session(tmp_path, HEADER)
    session.give(line("ball 1"))
    text = session.path.read_text()
    data = {
        "utf-16": text.encode("utf-16"),
        "header": text.replace('"patience": 1', '"patience": "1"').encode(),
        "twice": (text + text).encode(),
    }[edit]
    session.path.write_bytes(data)
    with pytest.raises(ValueError, match=r"line [123]: "):
        open_session(tmp_path, HEADER)
    assert session.path.read_bytes() == data


@pytest.mark.parametrize("change", ["append", "replace", "remove"])
def test_a_file_that_changes_while_its_session_is_open_is_not_written_over(tmp_path, change):
    session, _ = open_session(tmp_path, HEADER)
    session.give(line("ball 1"))
    other = session.path.read_bytes() + (json.dumps(line("ball 2")) + "\n").encode()
    if change != "append":
        session.path.unlink()
    if change != "remove":
        with session.path.open("wb" if change == "replace" else "r+b") as file:
            file.write(other)
    with pytest.raises(OSError, match="start it again: it reads the file anew"):
        session.give(line("ball 1", 2))
    assert [one.frame for one in session.answers] == [0]
    if change != "remove":
        assert session.path.read_bytes() == other
